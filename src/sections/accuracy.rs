//! The boundaries against the exact contours of the phantoms, under more and more noise.

use super::{Boundary, Params, SectionStack, extract};
use crate::geom::distance::SegmentIndex;
use crate::phantom::{self, Contrast, Kind, Vessel};
use crate::progress::Task;
use crate::segment::{self, Polarity};

const BOUNDARIES: [(&str, Boundary); 3] =
    [("model", Boundary::Model), ("half-maximum", Boundary::HalfMaximum), ("snake", Boundary::Snake)];

/// Distances of the contours' points from the truth, mm.
#[derive(Debug, Clone, Copy)]
struct Errors {
    mean: f64,
    p95: f64,
    /// Mean of the signed ones, positive outside.
    bias: f64,
}

fn errors(stack: &SectionStack, vessel: &Vessel) -> Errors {
    let of_plane = |p: &super::PlaneSections| -> Vec<f64> {
        let Some(truth) = SegmentIndex::try_new(&vessel.region_at(p.z_mm, 720).contours) else {
            return Vec::new();
        };
        p.contours.iter().flat_map(|c| &c.points).map(|&p| truth.signed_distance_mm(p)).collect()
    };
    let all: Vec<f64> = stack.planes.iter().flat_map(of_plane).collect();
    let mean = |of: fn(f64) -> f64| all.iter().map(|&d| of(d)).sum::<f64>() / all.len() as f64;
    let p95 = super::fit::quantile(all.iter().map(|d| d.abs()).collect(), 0.95).unwrap();
    Errors { mean: mean(f64::abs), p95, bias: mean(|d| d) }
}

/// Errors under every boundary, all from the same mask.
fn compared(kind: Kind, polarity: Contrast, noise_hu: f64) -> [Errors; 3] {
    let params = phantom::Params {
        kind,
        polarity,
        noise_hu,
        n_planes: 16,
        first_plane_z_mm: 45.0,
        n_pixels: 180,
        ..phantom::Params::default()
    };
    let volume = phantom::volume(&params, &Task::quiet());
    let seeds_patient_mm = vec![phantom::default_seed(&params)];
    let polarity = if polarity == Contrast::Bright { Polarity::Bright } else { Polarity::Dark };
    let asked = segment::Params { seeds_patient_mm, polarity, ..segment::Params::default() };
    let segmentation = segment::segment(&volume, &asked, &Task::quiet()).unwrap();
    let vessel = Vessel::new(kind);
    BOUNDARIES.map(|(_, boundary)| {
        let params = Params { boundary, ..Params::default() };
        errors(&extract(&volume, &segmentation, &params, &Task::quiet()).unwrap().stack, &vessel)
    })
}

#[test]
fn the_default_is_never_worse_than_half_maximum_nor_the_snake_far_off() {
    for kind in [Kind::Carotid, Kind::Tube] {
        for polarity in [Contrast::Bright, Contrast::Dark] {
            let [model, half, snake] = compared(kind, polarity, 25.0);
            assert!(model.mean <= half.mean, "{kind:?} {polarity:?}: model {model:?}, half-maximum {half:?}");
            // A tenth of a pixel, three tenths, a fortieth.
            assert!(model.mean <= 0.02 && model.p95 <= 0.06, "{kind:?} {polarity:?}: {model:?}");
            assert!(model.bias.abs() <= 0.005, "{kind:?} {polarity:?}: {model:?}");
            assert!(
                snake.mean < 2.0 * half.mean,
                "{kind:?} {polarity:?}: snake {snake:?}, half-maximum {half:?}"
            );
        }
    }
}

#[test]
#[ignore = "prints a table for the documentation, asserts nothing"]
#[expect(clippy::print_stdout, reason = "the table is what it is for")]
fn table() {
    println!(
        "{:<8} {:<7} {:>5}  mean error, 95th percentile and bias, mm: model, half-maximum, snake",
        "vessel", "lumen", "HU"
    );
    for kind in [Kind::Carotid, Kind::Tube] {
        for polarity in [Contrast::Bright, Contrast::Dark] {
            for noise_hu in [0.0, 25.0, 50.0] {
                let cells = compared(kind, polarity, noise_hu)
                    .map(|e| format!("{:.4} {:.4} {:+.4}", e.mean, e.p95, e.bias));
                println!("{:<8} {polarity:<7?} {noise_hu:>5}  {}", kind.name(), cells.join("  "));
            }
        }
    }
}
