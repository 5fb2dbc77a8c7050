//! The level of a wall that is hardly thicker than the blur.
//!
//! Behind such a wall the grey value goes on falling (to fat) or rises again (to air) before it has reached the wall's own
//! level, so that half-way between what is seen on both sides is not the boundary: 0.24 mm too far outward with 1 mm of
//! wall between contrast agent and fat, blurred by 0.35 mm. One profile is too noisy to tell the wall from the
//! blur; all profiles of a contour, laid over one another at their crossings and averaged, are fitted by the model of two
//! blurred steps ([`crate::sections::edge`]).
//!
//! Where no model fits the profiles of one contour (noise, something bright beside it), and more than half of all contours show a
//! wall, it has theirs, unless what it shows behind the boundary is nearer to the wall's own level: then its wall is thick.

use super::image::{Edge, Scan, median};
use crate::sections::edge::Profile;

/// A second step below this part of the first is none.
const LEAST_SECOND_STEP: f64 = 0.1;
/// A profile whose surroundings are off the usual ones by more than this part of the contrast has others, and keeps
/// the boundary of its own.
const OTHER_SURROUNDINGS: f64 = 0.25;
/// The mean profile reaches so many times the blur to either side.
const REACH_BLURS: f64 = 7.0;
/// At most so many samples to either side.
const MOST_SAMPLES: usize = 200;

/// The wall around a contour; the levels of a dark lumen have their sign changed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wall {
    level: f64,
    /// What the blurred second step adds to the value at the boundary.
    from_beyond: f64,
    blur_mm: f64,
    /// What the single profiles show beyond the boundary.
    seen: f64,
}

/// What one contour shows of its wall.
#[derive(Debug, Clone, Copy)]
pub(super) struct Behind {
    /// What the single profiles show beyond the boundary.
    pub(super) seen: f64,
    pub(super) wall: Option<Wall>,
}

impl Wall {
    /// The wall that most contours show; `None` where no more than half of them show one.
    pub(super) fn usual<'a>(all: impl Iterator<Item = &'a Behind>) -> Option<Self> {
        let all: Vec<&Behind> = all.collect();
        let walls: Vec<Self> = all.iter().filter_map(|b| b.wall).collect();
        if 2 * walls.len() <= all.len() {
            return None;
        }
        let usual = |get: fn(&Self) -> f64| median(walls.iter().map(get));
        Some(Self {
            level: usual(|w| w.level)?,
            from_beyond: usual(|w| w.from_beyond)?,
            blur_mm: usual(|w| w.blur_mm)?,
            seen: usual(|w| w.seen)?,
        })
    }

    /// Whether a contour that shows no wall is likely to have this one all the same.
    pub(super) fn is_hidden(&self, behind: &Behind) -> bool {
        behind.wall.is_none() && (behind.seen - self.seen).abs() < (behind.seen - self.level).abs()
    }

    /// The wall that the profiles of a contour show together; `None` where it is as thick as it looks, or none fits.
    pub(super) fn behind(scans: &[Option<Scan>], edges: &[Option<Edge>], step_mm: f64) -> Option<Self> {
        let seen = median(edges.iter().flatten().map(|e| e.bottom))?;
        let blur_mm = median(edges.iter().flatten().map(|e| e.blur_mm))?;
        let edge = mean_profile(scans, edges, step_mm, REACH_BLURS * blur_mm)?.edge()?;
        let second_step = edge.tissue - edge.wall;
        if second_step.abs() < LEAST_SECOND_STEP * (edge.lumen - edge.wall) {
            return None;
        }
        let from_beyond = edge.value_at_boundary() - edge.half_level();
        Some(Self { level: edge.wall, from_beyond, blur_mm: edge.blur_mm, seen })
    }

    /// The edges with the wall's level in place of what is seen behind it.
    pub(super) fn edges(&self, scans: &[Option<Scan>], edges: &[Option<Edge>]) -> Vec<Option<Edge>> {
        let edge = |(scan, edge): (&Option<Scan>, &Option<Edge>)| {
            let edge = (*edge)?;
            let same = (edge.bottom - self.seen).abs() <= OTHER_SURROUNDINGS * (edge.top - self.seen);
            if same { self.edge(scan.as_ref()?, edge) } else { Some(edge) }
        };
        scans.iter().zip(edges).map(edge).collect()
    }

    fn edge(&self, scan: &Scan, seen: Edge) -> Option<Edge> {
        let level = 0.5 * (seen.top + self.level) + self.from_beyond;
        let offset_mm = scan.crossing_mm(seen.offset_mm, level)?;
        Some(Edge { offset_mm, bottom: self.level, blur_mm: self.blur_mm, ..seen })
    }
}

/// The mean of all profiles, each shifted by its crossing; as far as half of them reach to both sides.
fn mean_profile(
    scans: &[Option<Scan>],
    edges: &[Option<Edge>],
    step_mm: f64,
    reach_mm: f64,
) -> Option<Profile> {
    let pairs: Vec<(&Scan, f64)> =
        scans.iter().zip(edges).filter_map(|(s, e)| Some((s.as_ref()?, e.as_ref()?.offset_mm))).collect();
    let mean = |d_mm: f64| {
        let values = pairs.iter().filter_map(|(scan, crossing_mm)| scan.at(crossing_mm + d_mm));
        let (sum, n) = values.fold((0.0, 0usize), |(sum, n), v| (sum + v, n + 1));
        (2 * n >= pairs.len() && n > 0).then(|| sum / n as f64)
    };
    let (mut inner, mut outer) = (Vec::new(), Vec::new());
    for m in 1..=MOST_SAMPLES {
        let d_mm = m as f64 * step_mm;
        let (Some(a), Some(b)) = (mean(-d_mm), mean(d_mm)) else { break };
        if d_mm > reach_mm {
            break;
        }
        inner.push(a);
        outer.push(b);
    }
    let values: Vec<f64> = inner.into_iter().rev().chain([mean(0.0)?]).chain(outer).collect();
    (values.len() >= 17).then_some(Profile { values, step_mm })
}

#[cfg(test)]
mod tests {
    use crate::geom::{Contour, Point2, Region};
    use crate::report::Image;
    use crate::report::deviation::{Figures, Outline, compare};
    use crate::report::image::{Polarity, boundaries, boundary};
    use crate::report::testing::blurred_shells;

    /// Mean distance and bias of a contour of 3.1 mm against what the image shows of a lumen of 3 mm.
    fn compared(polarity: Polarity, levels_hu: [f64; 3], noise_hu: f64) -> Figures {
        let [lumen, wall, beyond] = levels_hu;
        let volume = blurred_shells(&[(3.0, lumen), (4.0, wall)], beyond, 1, noise_hu);
        let contours = vec![Contour::circle(Point2::origin(), 3.1, 128)];
        let found = boundary(Image { volume: &volume, polarity }, 0, &contours, None);
        assert!(found.n_found * 10 >= found.n_points * 9);
        let contours: Outline = Region::new(contours).into();
        Figures::of(std::iter::once(&compare(&found.outline, &contours).unwrap()))
    }

    #[test]
    fn behind_a_thin_wall_the_boundary_is_half_way_to_the_wall() {
        let cases = [
            (Polarity::Bright, [300.0, 60.0, -90.0]),
            (Polarity::Bright, [300.0, 60.0, 60.0]),
            (Polarity::Bright, [300.0, 40.0, 160.0]),
            (Polarity::Dark, [-20.0, 120.0, 60.0]),
            (Polarity::Dark, [-20.0, 120.0, 180.0]),
        ];
        for (polarity, levels_hu) in cases {
            let f = compared(polarity, levels_hu, 0.0);
            assert!((f.bias_mm.unwrap() - 0.1).abs() < 0.02, "{levels_hu:?}: {f:?}");
            let f = compared(polarity, levels_hu, 0.05 * (levels_hu[0] - levels_hu[1]).abs());
            assert!((f.bias_mm.unwrap() - 0.1).abs() < 0.04, "{levels_hu:?}, noisy: {f:?}");
        }
    }

    #[test]
    fn a_contour_whose_profiles_fit_no_wall_has_that_of_the_others() {
        let usual = [(3.0, 300.0), (4.0, 60.0)];
        let odd = [(3.0, 300.0), (4.0, 60.0), (4.7, -90.0), (5.2, 200.0)];
        let plane = |shells: &[(f64, f64)]| blurred_shells(shells, -90.0, 1, 0.0);
        let mut volume = blurred_shells(&usual, -90.0, 3, 0.0);
        let n = volume.dims[0] * volume.dims[1];
        let hu: Vec<f32> = [&usual[..], &odd[..], &usual[..]]
            .iter()
            .flat_map(|s| plane(s).hu.iter().collect::<Vec<_>>())
            .collect();
        volume.hu = crate::ct::Voxels::new(&hu, n);
        let contours = vec![Contour::circle(Point2::origin(), 3.1, 128)];
        let outline: Outline = Region::new(contours.clone()).into();
        let bias = |found: &Outline| {
            Figures::of(std::iter::once(&compare(found, &outline).unwrap())).bias_mm.unwrap()
        };
        let image = Image { volume: &volume, polarity: Polarity::Bright };
        let alone = boundary(image, 1, &contours, None);
        assert!(alone.walls[0].wall.is_none() && bias(&alone.outline) < 0.0, "{}", bias(&alone.outline));
        let planes: Vec<_> = (0..3).map(|k| (Some(k), contours.as_slice())).collect();
        for found in boundaries(image, &planes) {
            let off = bias(&found.unwrap().outline);
            assert!((off - 0.1).abs() < 0.04, "{off}");
        }
    }
}
