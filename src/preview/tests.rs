use super::*;
use crate::geom::{Contour, Region};
use crate::profile;
use crate::slice::{Layer, LayerSlot};
use crate::toolpath::plan;

/// Two layers of a ring of 3 and 4 mm, the second on CT plane 7.
fn ring() -> Toolpaths {
    let circle = |r: f64| Contour::circle(Point2::new(0.0, 0.0), r, 96);
    let layer = |z_mid_mm: f64, ct_plane| Layer {
        slot: LayerSlot { z_mid_mm, height_mm: 0.2, ct_plane },
        material: Region::new(vec![circle(4.0), circle(3.0).reversed()]),
        lumen: Region::new(vec![circle(3.0)]),
    };
    let profile = profile::load::by_name("reference").unwrap();
    plan(&[layer(0.1, None), layer(0.3, Some(7))], &profile, &Task::quiet()).unwrap().paths
}

#[test]
fn every_layer_has_a_picture_of_one_size_and_an_svg_of_its_beads() {
    let paths = ring();
    let previews = of_layers(&paths, &Task::quiet()).unwrap();
    assert_eq!(previews.iter().map(Preview::file_stem).collect::<Vec<_>>(), ["layer-0000", "layer-0001"]);
    let size = |p: &Preview| {
        let reader = png::Decoder::new(std::io::Cursor::new(&p.png)).read_info().unwrap();
        (reader.info().width, reader.info().height)
    };
    assert_eq!(size(&previews[0]), size(&previews[1]));
    assert!(previews[1].svg.contains("<title>layer 1  z 0.40 mm  CT plane 7</title>"));
    assert!(draw::is_drawn(&caption(1, &paths.layers[1])));
    let n_external = previews[0].svg.matches("data-type=\"External perimeter\"").count();
    assert!(n_external >= 2, "{n_external}");
    // A way to each bead, the one from the layer below among them.
    let n_ways = |layer: usize| previews[layer].svg.matches("stroke=\"#466e96\"").count();
    let n_beads = |layer: usize| paths.layers[layer].beads.len();
    assert_eq!([n_ways(0), n_ways(1)], [n_beads(0) - 1, n_beads(1)]);
    let from = paths.layers[0].beads.last().unwrap().points.last().unwrap().at;
    assert!(previews[1].svg.contains(&format!("points=\"{:.3},{:.3} ", from.x, from.y)), "{from}");
    assert_eq!(of_layers(&paths, &Task::quiet()).unwrap(), previews);
}

#[test]
fn the_portrait_shows_the_part_in_the_middle_of_a_square_and_is_always_the_same() {
    let paths = ring();
    let png = portrait(&paths, 64, &Task::quiet()).unwrap();
    assert_eq!(png, portrait(&paths, 64, &Task::quiet()).unwrap());
    let mut reader = png::Decoder::new(std::io::Cursor::new(&png)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((info.width, info.height), (64, 64));
    let is_part = |x: usize, y: usize| pixels[3 * (y * 64 + x) + 2] < 200;
    assert!(!is_part(1, 1) && !is_part(62, 62), "the corners are free");
    // Through the ring's middle: wall, lumen, wall.
    let row: Vec<bool> = (0..64).map(|x| is_part(x, 32)).collect();
    let changes = row.windows(2).filter(|p| p[0] != p[1]).count();
    assert_eq!(changes, 4, "{row:?}");
}

#[test]
fn the_portrait_of_nothing_is_plain() {
    let nothing = Toolpaths { layers: Vec::new(), ..ring() };
    assert!(portrait(&nothing, 32, &Task::quiet()).is_ok());
}

#[test]
fn beads_cover_the_material_in_their_colours() {
    let paths = ring();
    let frame = Frame::of(&paths.layers);
    let previews = of_layers(&paths, &Task::quiet()).unwrap();
    let mut reader = png::Decoder::new(std::io::Cursor::new(&previews[0].png)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    let n_of = |colour: [u8; 3]| pixels.chunks_exact(3).filter(|p| *p == colour).count() as f64;
    let px2 = frame.px_per_mm * frame.px_per_mm;
    // The wall of 7 pi mm2 is bead from skin to skin; hardly any of what was to be filled shows.
    let wall = 7.0 * std::f64::consts::PI;
    let beads = n_of(colour(BeadKind::ExternalPerimeter)) + n_of(colour(BeadKind::Perimeter));
    assert!((beads / px2 / wall - 1.0).abs() < 0.1, "{}", beads / px2 / wall);
    // Its colour in the legend is nearly all that shows of what is left empty; the rest is where loops begin and end.
    let empty = (n_of([205, 205, 205]) - 14.0 * 14.0) / px2 / wall;
    assert!(empty < 2.5e-3, "{empty}");
}

#[test]
fn a_job_without_beads_is_drawn_empty() {
    let empty = Toolpaths { layers: Vec::new(), ..ring() };
    assert!(of_layers(&empty, &Task::quiet()).unwrap().is_empty());
}

/// Two layers of a bar, filled; the first bead of the upper one is of each kind in turn.
fn bar(size_mm: [f64; 2]) -> Toolpaths {
    let corners = [(0.0, 0.0), (size_mm[0], 0.0), (size_mm[0], size_mm[1]), (0.0, size_mm[1])];
    let outline = Contour::new(corners.map(|(x, y)| Point2::new(x, y)).to_vec());
    let layer = |z_mid_mm: f64| Layer {
        slot: LayerSlot { z_mid_mm, height_mm: 0.2, ct_plane: Some(12) },
        material: Region::new(vec![outline.clone()]),
        lumen: Region::default(),
    };
    let profile = profile::load::by_name("reference").unwrap();
    let mut paths = plan(&[layer(0.1), layer(0.3)], &profile, &Task::quiet()).unwrap().paths;
    let bead = paths.layers[1].beads[0].clone();
    paths.layers[1].beads.extend(KINDS.map(|kind| Bead { kind, ..bead.clone() }));
    paths
}

/// Kinds that the lower layer of a bar has not.
const KINDS: [BeadKind; 7] = [
    BeadKind::InternalInfill,
    BeadKind::Perimeter,
    BeadKind::Bridge,
    BeadKind::SkirtBrim,
    BeadKind::SupportMaterial,
    BeadKind::SupportInterface,
    BeadKind::Rib,
];

#[test]
fn the_legend_is_whole_beside_flat_and_narrow_parts() {
    for size_mm in [[120.0, 4.0], [3.0, 120.0]] {
        let png = &of_layers(&bar(size_mm), &Task::quiet()).unwrap()[0].png;
        let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        let kinds = KINDS.iter().filter(|k| **k != BeadKind::Perimeter);
        for kind in kinds {
            let swatch = colour(*kind);
            let n = pixels.chunks_exact(3).filter(|p| *p == swatch).count();
            assert_eq!(n, 14 * 14, "{kind:?} beside {size_mm:?} mm");
        }
        // The first line, beside the caption.
        let swatch = colour(BeadKind::ExternalPerimeter);
        let width = reader.info().width as usize;
        let is_swatch = |x: usize, y: usize| pixels[3 * (y * width + x)..][..3] == swatch;
        let n_whole = (0..width - 13).filter(|x| (0..14).all(|i| (0..14).all(|j| is_swatch(x + i, 12 + j))));
        assert_eq!(n_whole.count(), 1, "the caption runs into the legend beside {size_mm:?} mm");
    }
}

#[test]
fn the_legend_names_the_kinds_of_the_job() {
    let mut paths = ring();
    paths.layers[1].beads[0].kind = BeadKind::Bridge;
    let frame = Frame::of(&paths.layers);
    assert!(frame.kinds.contains(&BeadKind::Bridge) && frame.kinds.contains(&BeadKind::ExternalPerimeter));
    assert!(!frame.kinds.contains(&BeadKind::SupportMaterial));
    let [width, height] = frame.size_px();
    assert!(f64::from(height) > 20.0 + 10.0 * f64::from(LEGEND_LINE_PX), "there is room for every kind");
    for kind in &frame.kinds {
        assert!(draw::is_drawn(kind.name()), "{kind:?}");
        let text_px = draw::text_width(kind.name(), LEGEND_UNIT);
        assert!(whole(text_px) + 22 < frame.legend_px(), "{kind:?} is cut off");
    }
    // In the first layer, too, where there is no bridge.
    let png = &of_layers(&paths, &Task::quiet()).unwrap()[0].png;
    let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!(info.width, width + frame.legend_px());
    let swatch = colour(BeadKind::Bridge);
    assert_eq!(pixels.chunks_exact(3).filter(|p| *p == swatch).count(), 14 * 14);
}
