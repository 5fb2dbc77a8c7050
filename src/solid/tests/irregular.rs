//! Planes at irregular distances, and contours that a segmentation moved a little.

use super::*;
use crate::brep::{self, Brep};

/// Planes 3 mm apart, and one more a gap above the one at z 15.
fn heights(gap_mm: f64) -> Vec<f64> {
    let mut all: Vec<f64> = (0..12).map(|k| 3.0 * f64::from(k)).collect();
    all.insert(6, 15.0 + gap_mm);
    all
}

/// A vessel of 3 mm radius along an axis; the contour `moved` lies aside.
fn tube(heights: &[f64], axis: impl Fn(f64) -> Point2, moved: (usize, f64)) -> SectionStack {
    let plane = |(k, &z_mm): (usize, &f64)| {
        let aside = if k == moved.0 { moved.1 } else { 0.0 };
        let centre = axis(z_mm) + crate::geom::Vector2::new(aside, 0.0);
        PlaneSections { z_mm, contours: vec![Contour::circle(centre, 3.0, 128)] }
    };
    stack(heights.iter().enumerate().map(plane).collect())
}

/// How far the lumen's section is from a disk of 3 mm radius about the axis, at most, from z to z.
fn strays_mm(solid: &Solid, [from, to]: [f64; 2], axis: impl Fn(f64) -> Point2) -> f64 {
    let n = 400;
    let off = |k: i32| {
        let z_mm = from + (to - from) * f64::from(k) / f64::from(n);
        let section = solid.section(z_mm, 1e-4);
        let lumen = if section.lumen.contours.is_empty() { section.outer } else { section.lumen };
        let [contour] = &lumen.contours[..] else { return f64::INFINITY };
        let from_disk = |p: &Point2| ((p - axis(z_mm)).norm() - 3.0).abs();
        contour.points.iter().map(from_disk).fold(0.0, f64::max)
    };
    (0..=n).map(off).fold(0.0, f64::max)
}

fn passes_all_planes(solid: &Solid, stack: &SectionStack) -> bool {
    stack.planes.iter().all(|plane| {
        let section = solid.section(plane.z_mm, 1e-5);
        let lumen = if solid.outer.is_some() { section.lumen } else { section.outer };
        farthest(&plane.region(), &lumen) < 1e-3
    })
}

#[test]
fn a_contour_moved_by_noise_on_a_close_plane_moves_the_tube_by_no_more_than_itself() {
    let straight = |_: f64| Point2::origin();
    let bent = |z: f64| Point2::new(4.0 * (z / 12.0).sin(), 0.3 * z);
    for (gap_mm, aside_mm) in [(0.001, 0.02), (0.01, 0.02), (0.1, 0.1), (0.3, 0.2), (0.002, 0.3)] {
        let heights = heights(gap_mm);
        let given = tube(&heights, straight, (6, aside_mm));
        let solid = cast(&given);
        let strays = strays_mm(&solid, [0.0, 33.0], straight);
        assert!(strays < 1.2 * aside_mm + 0.02, "{gap_mm} {aside_mm}: {strays}");
        assert!(passes_all_planes(&solid, &given), "{gap_mm} {aside_mm}");
        brep::check(&Brep::of(&solid, SkinChoice::All)).unwrap();
        // What the bend itself is missed by without the plane.
        let regular = cast(&tube(&heights, bent, (6, 0.0)));
        let least = strays_mm(&regular, [6.0, 24.0], bent);
        let strays = strays_mm(&cast(&tube(&heights, bent, (6, aside_mm))), [6.0, 24.0], bent);
        assert!(strays < 1.2 * aside_mm + 0.03 + least, "bent {gap_mm} {aside_mm}: {strays}, {least}");
    }
}

#[test]
fn a_plane_given_twice_at_an_end_of_the_stack_moves_nothing() {
    let straight = |_: f64| Point2::origin();
    let mut low = vec![0.0, 0.002];
    low.extend((1..10).map(|k| 3.0 * f64::from(k)));
    let high: Vec<f64> = low.iter().rev().map(|z| 27.0 - z).collect();
    for (heights, moved) in [(&low, 0), (&low, 1), (&high, 9), (&high, 10)] {
        let strays = strays_mm(&cast(&tube(heights, straight, (moved, 0.02))), [0.0, 27.0], straight);
        assert!(strays < 0.05, "{moved}: {strays}");
    }
}

#[test]
fn planes_that_grow_closer_and_farther_keep_the_tube_and_its_wall() {
    let bent = |z: f64| Point2::new(2.0 * (z / 15.0).sin(), 0.2 * z);
    let steps = [3.0, 3.0, 3.0, 0.3, 0.3, 0.3, 3.0, 0.05, 3.0, 3.0, 1.0, 0.01, 1.0, 3.0, 3.0];
    let mut heights = vec![0.0];
    heights.extend(steps.iter().scan(0.0, |z, step| {
        *z += step;
        Some(*z)
    }));
    for moved in [3, 4, 7, 8, 11, 12] {
        let given = tube(&heights, bent, (moved, 0.02));
        let built = build(&given, &Params::new(Body::Wall { wall_mm: 1.0 }), &Task::quiet()).unwrap();
        let strays = strays_mm(&built.solid, [heights[0], heights[heights.len() - 1]], bent);
        assert!(strays < 0.09, "{moved}: {strays}");
        assert!(passes_all_planes(&built.solid, &given), "{moved}");
        brep::check(&Brep::of(&built.solid, SkinChoice::All)).unwrap();
        let thickness = built.thickness.unwrap();
        assert!(thickness.least_mm > 0.96 && thickness.most_mm < 1.04, "{moved}: {thickness:?}");
    }
}

#[test]
fn a_dome_beside_a_close_plane_keeps_to_its_contours() {
    let trunk = |_: f64| Contour::circle(Point2::new(-9.0, 0.0), 5.0, 128);
    let radius = |z: f64| 2.4 * (1.0 - ((z - 10.5 + 3.6) / 3.6).clamp(0.0, 1.0).powi(3)).sqrt();
    for wider in [0.001, 0.005, 0.02] {
        let mut planes: Vec<PlaneSections> = Vec::new();
        for k in 0..=30 {
            let z_mm = (f64::from(k) / 3.0 * 1e4).round() / 1e4;
            let r = radius(z_mm) + if k == 29 { wider } else { 0.0 };
            planes.push(PlaneSections {
                z_mm,
                contours: vec![trunk(z_mm), Contour::circle(Point2::origin(), r, 128)],
            });
        }
        for k in 0..6 {
            let z_mm = 11.0 + f64::from(k);
            planes.push(PlaneSections { z_mm, contours: vec![trunk(z_mm)] });
        }
        let solid = cast(&stack(planes));
        for k in 0..200 {
            let z_mm = 8.0 + 2.0 * f64::from(k) / 200.0;
            let section = solid.section(z_mm, 1e-4).outer;
            let of = section.contours.iter().map(|c| (c.signed_area_mm2() / std::f64::consts::PI).sqrt());
            let least = of.fold(f64::INFINITY, f64::min);
            assert!(
                (least - radius(z_mm)).abs() < 0.03 + 1.5 * wider,
                "{wider} z {z_mm}: {least} {}",
                radius(z_mm)
            );
        }
    }
}

/// Two disks that part between the planes at z 15 and 18 mm, and a plane a gap above one of those, whose contours lie aside.
fn parting(beside: usize, gap_mm: f64, aside_mm: f64) -> [SectionStack; 2] {
    let contours = |z: f64| {
        let x = (0.35 * (z - 10.0)).max(0.3);
        let disks = [-x, x].map(|x| Region::new(vec![Contour::circle(Point2::new(x, 0.02 * z), 2.2, 256)]));
        Region::union_all(&disks).contours.iter().map(|c| c.resampled(48)).collect::<Vec<_>>()
    };
    let plane = |z_mm: f64| PlaneSections { z_mm, contours: contours(z_mm) };
    let regular: Vec<PlaneSections> = (0..13).map(|k| plane(3.0 * f64::from(k))).collect();
    let mut close = plane(regular[beside].z_mm + gap_mm);
    close.contours.iter_mut().flat_map(|c| &mut c.points).for_each(|p| p.x += aside_mm);
    let mut planes = regular.clone();
    planes.insert(beside + 1, close);
    [stack(regular), stack(planes)]
}

#[test]
fn a_close_plane_beside_a_split_moves_it_by_little_more_than_itself() {
    for (beside, gap_mm, aside_mm) in
        [(5, 0.001, 0.02), (6, 0.001, 0.02), (5, 0.1, 0.05), (6, 0.1, 0.05), (7, 0.01, 0.02)]
    {
        let [without, with] = parting(beside, gap_mm, aside_mm).map(|stack| cast(&stack));
        brep::check(&Brep::of(&with, SkinChoice::All)).unwrap();
        for k in 0..350 {
            let z_mm = 0.1 * f64::from(k);
            let [a, b] = [&with, &without].map(|solid| solid.section(z_mm, 1e-4).outer);
            let off = farthest(&a, &b);
            assert!(off < aside_mm + 0.02, "{beside} {gap_mm}, z {z_mm}: {off}");
        }
    }
}
