use super::*;
use crate::model::testing::{cuboid, inverted, miswound, moved, tube};
use crate::model::{Facet, Model};
use std::f64::consts::PI;

const PARAMS: GridParams = GridParams { layer_mm: 0.2, height_limits_mm: [0.05, 0.3] };

fn sliced(facets: &[Facet]) -> Result<MeshLayers, Error> {
    slice_mesh(&Model::of(facets).unwrap().mesh, &PARAMS, &Task::quiet())
}

fn volume_mm3(sliced: &MeshLayers) -> f64 {
    sliced.layers.iter().map(|l| l.material.area_mm2() * l.slot.height_mm).sum()
}

#[test]
fn a_tube_has_the_area_of_its_annulus_and_its_hole_is_the_lumen() {
    let n = 96;
    let made = sliced(&tube(3.0, 4.0, 6.0, n)).unwrap();
    let polygon = |r: f64| 0.5 * f64::from(n) * r * r * (2.0 * PI / f64::from(n)).sin();
    assert_eq!(made.layers.len(), 30);
    for layer in &made.layers {
        assert!((layer.material.area_mm2() / (polygon(4.0) - polygon(3.0)) - 1.0).abs() < 1e-6);
        assert!((layer.lumen.area_mm2() / polygon(3.0) - 1.0).abs() < 1e-6);
    }
    assert!(made.warnings.is_empty(), "{:?}", made.warnings);
}

#[test]
fn a_plane_through_vertices_is_no_special_case() {
    // Layers of 0.2 mm are cut at 0.1, 0.3, ...: vertices lie at 0.5 mm.
    let stacked = [cuboid([2.0, 2.0, 0.5]), moved(&cuboid([2.0, 2.0, 0.7]), [0.0, 0.0, 0.5])].concat();
    let made = sliced(&stacked).unwrap();
    assert_eq!(made.layers.len(), 6);
    assert!((volume_mm3(&made) - 4.8).abs() < 1e-4, "{}", volume_mm3(&made));
}

#[test]
fn the_order_of_the_triangles_does_not_matter() {
    let facets = [tube(1.0, 2.0, 3.0, 24), moved(&tube(0.0, 1.5, 2.0, 17), [5.0, 0.0, 0.0])].concat();
    let shuffled: Vec<Facet> = facets.iter().rev().map(|&[a, b, c]| [b, c, a]).collect();
    assert_eq!(sliced(&shuffled).unwrap(), sliced(&facets).unwrap());
}

#[test]
fn bodies_that_overlap_lie_in_each_other_or_face_inward_are_united() {
    let (big, small) = (cuboid([4.0, 4.0, 2.0]), cuboid([1.0, 1.0, 2.0]));
    for (facets, volume) in [
        ([big.clone(), moved(&big, [2.0, 1.0, 0.0])].concat(), 2.0 * (32.0 - 6.0)),
        ([big.clone(), moved(&small, [1.0, 1.0, 0.0])].concat(), 32.0),
        ([big.clone(), moved(&inverted(&small), [6.0, 0.0, 0.0])].concat(), 34.0),
    ] {
        let made = sliced(&facets).unwrap();
        assert!((volume_mm3(&made) / volume - 1.0).abs() < 1e-6, "{} for {volume}", volume_mm3(&made));
        assert_eq!(made.warnings[0].code, "model.overlaps");
    }
    // A void in a body faces inward, too, and is one.
    let hollow = [big, moved(&inverted(&small), [1.0, 1.0, 0.0])].concat();
    assert!((volume_mm3(&sliced(&hollow).unwrap()) - 30.0).abs() < 1e-5);
}

#[test]
fn narrow_gaps_are_closed_and_told_and_wide_ones_refused() {
    // One side face is missing: its outline is open over the whole side.
    let without_side = |size: [f32; 3]| -> Vec<Facet> {
        let is_side = |f: &&Facet| !f.iter().all(|corner| corner[0] == 0.0);
        cuboid(size).iter().filter(is_side).copied().collect()
    };
    let closed = sliced(&without_side([3.0, 0.25, 2.0])).unwrap();
    assert!((volume_mm3(&closed) - 1.5).abs() < 1e-5);
    assert_eq!(closed.warnings[0].code, "model.open");
    assert!(closed.warnings[0].text.contains("10 gap(s)"), "{}", closed.warnings[0].text);
    let refused = sliced(&without_side([3.0, 2.0, 2.0])).unwrap_err();
    assert!(matches!(refused, Error::OpenMesh { layer: 0, gap_mm, .. } if (gap_mm - 2.0).abs() < 1e-6));
}

#[test]
fn a_mesh_that_is_flatter_than_a_layer_is_refused() {
    let refused = sliced(&cuboid([3.0, 2.5, 0.02])).unwrap_err().to_string();
    let expected =
        "the model is 3 x 2.5 x 0.02 mm: too low for layers of 0.05 to 0.3 mm; are the units millimetres?";
    assert_eq!(refused, expected);
}

#[test]
fn a_bore_whose_triangles_face_both_ways_stays_open() {
    let made = sliced(&miswound(&tube(3.0, 4.0, 6.0, 96), |k| k % 2 == 0)).unwrap();
    assert_eq!(made, sliced(&tube(3.0, 4.0, 6.0, 96)).unwrap());
    assert!(made.layers.iter().all(|l| l.lumen.contours.len() == 1));
}
