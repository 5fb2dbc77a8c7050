//! The tables of the built-in vessels: centrelines and radii by knots, mm, patient frame, z towards the head.
//!
//! The shapes are drawn by hand after what textbooks give for calibres and angles (common carotid 6 mm, internal
//! 4.5 mm with a bulb, external 3.5 mm; vertebral 3.5 mm, basilar 4 mm); they copy no patient and no data set.
//! A branch starts inside its parent, thinner by more than the smooth minimum's radius, so that it does not show there.

use super::Kind;
use super::spline::NaturalSpline;
use super::vessel::{Narrowing, Ripple, Tube, Vessel};
use crate::geom::Point2;

type Knots = &'static [(f64, f64)];

/// Sections that are slightly oval, the oval turning slowly along the vessel.
const OVAL: &[Ripple] = &[
    Ripple { order: 2, amplitude: 0.04, phase_rad: 0.8, twist_rad_per_mm: 0.025 },
    Ripple { order: 3, amplitude: 0.015, phase_rad: 2.1, twist_rad_per_mm: -0.04 },
];

/// Degree of the built-in stenosis after NASCET: 1 - narrowest diameter / distal diameter.
pub(super) const STENOSIS_DEGREE: f64 = 0.7;
/// Height of the narrowest place and of the normal segment beyond it, mm.
pub(super) const STENOSIS_Z_MM: [f64; 2] = [87.0, 120.0];

pub(super) fn vessel(kind: Kind) -> Vessel {
    let (tubes, middle) = match kind {
        Kind::Carotid => (carotid(), Point2::new(20.5, 1.5)),
        Kind::Stenosis => (stenosed(carotid()), Point2::new(20.5, 1.5)),
        Kind::Trifurcation => (trifurcation(), Point2::new(-14.0, 6.0)),
        Kind::Merge => (merge(), Point2::new(1.0, 12.0)),
        Kind::Tube => (vec![bent_tube()], Point2::new(-8.0, -5.0)),
    };
    Vessel { tubes, blend_radius_mm: 1.0, middle }
}

fn tube(x: Knots, y: Knots, radius: Knots, ripples: &'static [Ripple]) -> Tube {
    let [x, y, radius] = [x, y, radius].map(NaturalSpline::new);
    Tube { x, y, radius, narrowing: None, ripples }
}

/// Common carotid into the internal artery (lateral, behind, with its bulb) and the external (medial, in front).
fn carotid() -> Vec<Tube> {
    let common_internal = tube(
        &[
            (0.0, 19.2),
            (25.0, 19.9),
            (45.0, 20.6),
            (58.0, 21.2),
            (68.0, 22.4),
            (78.0, 24.2),
            (92.0, 26.2),
            (112.0, 26.9),
            (138.0, 26.0),
        ],
        &[
            (0.0, 3.4),
            (25.0, 2.6),
            (45.0, 2.2),
            (58.0, 2.5),
            (68.0, 3.5),
            (78.0, 4.9),
            (92.0, 6.2),
            (112.0, 6.6),
            (138.0, 5.6),
        ],
        &[
            (0.0, 3.15),
            (30.0, 3.05),
            (55.0, 3.1),
            (64.0, 3.4),
            (71.0, 3.55),
            (79.0, 3.0),
            (88.0, 2.45),
            (105.0, 2.3),
            (138.0, 2.15),
        ],
        OVAL,
    );
    let external = tube(
        &[
            (0.0, 19.2),
            (25.0, 19.9),
            (45.0, 20.6),
            (58.0, 20.7),
            (68.0, 18.9),
            (78.0, 16.8),
            (92.0, 15.0),
            (112.0, 14.2),
            (138.0, 14.0),
        ],
        &[
            (0.0, 3.4),
            (25.0, 2.6),
            (45.0, 2.1),
            (58.0, 1.7),
            (68.0, 0.2),
            (78.0, -1.6),
            (92.0, -3.2),
            (112.0, -3.9),
            (138.0, -3.3),
        ],
        &[(0.0, 1.6), (45.0, 1.65), (60.0, 1.9), (75.0, 1.9), (100.0, 1.75), (138.0, 1.6)],
        OVAL,
    );
    vec![common_internal, external]
}

/// The internal carotid narrowed above its bulb to the built-in degree.
fn stenosed(mut tubes: Vec<Tube>) -> Vec<Tube> {
    let [throat, distal] = STENOSIS_Z_MM;
    let internal = &mut tubes[0];
    let depth = 1.0 - (1.0 - STENOSIS_DEGREE) * internal.radius_at(distal) / internal.radius_at(throat);
    internal.narrowing = Some(Narrowing { z_mm: throat, width_mm: 5.0, depth });
    tubes
}

/// A trunk into three branches at one level.
fn trifurcation() -> Vec<Tube> {
    let ahead = tube(
        &[
            (0.0, -13.0),
            (40.0, -13.8),
            (63.5, -14.0),
            (71.5, -14.1),
            (81.5, -14.2),
            (100.0, -14.0),
            (138.0, -13.5),
        ],
        &[(0.0, 4.0), (40.0, 4.6), (63.5, 5.4), (71.5, 7.2), (81.5, 9.8), (100.0, 12.4), (138.0, 13.0)],
        &[(0.0, 3.7), (45.0, 3.6), (61.5, 3.3), (71.5, 2.35), (83.5, 2.0), (138.0, 1.9)],
        OVAL,
    );
    let left = tube(
        &[
            (0.0, -13.0),
            (40.0, -13.8),
            (61.5, -13.3),
            (71.5, -10.4),
            (81.5, -7.6),
            (100.0, -4.6),
            (138.0, -3.4),
        ],
        &[(0.0, 4.0), (40.0, 4.6), (61.5, 4.4), (71.5, 3.0), (81.5, 1.6), (100.0, 0.2), (138.0, 0.0)],
        &[(0.0, 1.5), (50.0, 1.6), (65.0, 1.9), (138.0, 1.8)],
        OVAL,
    );
    let right = tube(
        &[
            (0.0, -13.0),
            (40.0, -13.8),
            (61.5, -14.6),
            (71.5, -17.6),
            (81.5, -20.5),
            (100.0, -23.4),
            (138.0, -24.6),
        ],
        &[(0.0, 4.0), (40.0, 4.6), (61.5, 4.4), (71.5, 2.9), (81.5, 1.4), (100.0, -0.2), (138.0, -0.6)],
        &[(0.0, 1.5), (50.0, 1.6), (65.0, 1.9), (138.0, 1.75)],
        OVAL,
    );
    vec![ahead, left, right]
}

/// A trunk that divides around an island and is one again above it.
fn merge() -> Vec<Tube> {
    let trunk = tube(
        &[
            (0.0, 1.0),
            (30.0, 0.7),
            (45.0, -0.9),
            (58.0, -3.0),
            (72.0, -3.6),
            (86.0, -2.7),
            (98.0, -0.6),
            (112.0, 0.9),
            (138.0, 1.2),
        ],
        &[(0.0, 12.6), (30.0, 12.1), (58.0, 11.4), (72.0, 11.0), (98.0, 11.6), (138.0, 12.0)],
        &[(0.0, 2.9), (38.0, 2.8), (54.0, 2.3), (72.0, 2.1), (90.0, 2.3), (104.0, 2.7), (138.0, 2.6)],
        OVAL,
    );
    let detour = tube(
        &[
            (0.0, 1.0),
            (30.0, 0.8),
            (45.0, 1.9),
            (58.0, 4.4),
            (72.0, 5.2),
            (86.0, 4.1),
            (98.0, 1.9),
            (112.0, 0.9),
            (138.0, 1.2),
        ],
        &[(0.0, 12.6), (30.0, 12.1), (58.0, 12.2), (72.0, 12.6), (98.0, 11.9), (138.0, 12.0)],
        &[(0.0, 1.4), (36.0, 1.4), (52.0, 1.7), (72.0, 1.75), (92.0, 1.7), (108.0, 1.3), (138.0, 1.2)],
        OVAL,
    );
    vec![trunk, detour]
}

/// One bent tube with round horizontal sections, so that its area is pi r^2 at every height.
fn bent_tube() -> Tube {
    tube(
        &[(0.0, -10.0), (35.0, -7.0), (70.0, -9.5), (105.0, -6.0), (138.0, -8.0)],
        &[(0.0, -5.0), (40.0, -6.5), (80.0, -3.5), (138.0, -5.5)],
        &[(0.0, 3.0), (50.0, 2.4), (90.0, 3.2), (138.0, 2.6)],
        &[],
    )
}
