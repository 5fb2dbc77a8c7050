use super::*;
use crate::profile::{self, BeadShape};
use proptest::prelude::*;

/// A profile whose firmware has arcs, in chords that leave them by next to nothing.
fn with_arcs(tolerance_mm: f64) -> Profile {
    let mut profile = profile::builtin("reprapfirmware").unwrap();
    profile.firmware.arcs = true;
    profile.firmware.arc_deviation_mm = 1e-4;
    profile.print.tolerance_mm = tolerance_mm;
    profile
}

fn model() -> BeadModel {
    BeadModel::new(BeadShape::Rectangle, 0.2)
}

fn at_speed(speed_mm_s: f64) -> Pace {
    Pace { speed_mm_s, slow_down: 1.0, least_mm_s: 10.0 }
}

fn bead(points: impl Iterator<Item = (f64, f64)>) -> Vec<BeadPoint> {
    points.map(|(x, y)| BeadPoint { at: Point2::new(x, y).map(on_grid_mm), width_mm: 0.4 }).collect()
}

/// An ellipse from angle to angle, in n segments.
fn ellipse(a: f64, b: f64, from: f64, to: f64, n: u32) -> Vec<BeadPoint> {
    bead((0..=n).map(|i| {
        let angle = from + (to - from) * f64::from(i) / f64::from(n);
        (100.0 + a * angle.cos(), 100.0 + b * angle.sin())
    }))
}

/// Points along the moves, no farther apart than 0.01 mm, and the moves' numbers.
fn sampled(begin: Point2, pieces: &[Piece]) -> Vec<Point2> {
    let mut at = begin;
    let mut points = vec![begin];
    for piece in pieces {
        let n = (piece.length_mm / 0.01).ceil().max(1.0);
        let mut k = 1.0;
        while k <= n {
            let share = k / n;
            points.push(piece.arc.map_or(at + (piece.to - at) * share, |arc| {
                let angle = turn(at, piece.to, arc) * share * if arc.is_ccw { 1.0 } else { -1.0 };
                arc.centre + nalgebra::Rotation2::new(angle) * (at - arc.centre)
            }));
            k += 1.0;
        }
        at = piece.to;
    }
    points
}

fn farthest_from_line(points: &[Point2], line: &[BeadPoint]) -> f64 {
    let distance =
        |p: &Point2| line.windows(2).map(|l| distance_mm(*p, l[0].at, l[1].at)).fold(f64::INFINITY, f64::min);
    points.iter().map(distance).fold(0.0, f64::max)
}

#[test]
fn a_circle_becomes_two_arcs_with_all_its_filament() {
    let circle = ellipse(4.0, 4.0, 0.0, 2.0 * PI, 300);
    let pieces = pieces(&circle, model(), at_speed(30.0), &with_arcs(0.005));
    assert_eq!(pieces.iter().filter(|p| p.arc.is_some()).count(), pieces.len());
    assert!(pieces.len() <= 3, "{}", pieces.len());
    let volume: f64 = pieces.iter().map(|p| p.mm3).sum();
    assert!((volume / (2.0 * PI * 4.0 * 0.08) - 1.0).abs() < 1e-3, "{volume}");
}

#[test]
fn no_arc_without_the_firmware_s_or_where_its_chords_are_too_coarse() {
    let circle = ellipse(4.0, 4.0, 0.0, PI, 200);
    let is_arc =
        |profile: &Profile| pieces(&circle, model(), at_speed(30.0), profile).iter().any(|p| p.arc.is_some());
    let mut profile = with_arcs(0.005);
    assert!(is_arc(&profile));
    // 1 mm on a radius of 4 mm: 0.031 mm.
    profile.firmware.arc_deviation_mm = 0.0;
    profile.firmware.arc_segment_mm = 1.0;
    assert!(!is_arc(&profile));
    profile = with_arcs(0.005);
    profile.firmware.arcs = false;
    assert!(!is_arc(&profile));
}

#[test]
fn straight_lines_and_corners_are_no_arcs() {
    let zigzag = bead((0..100).map(|i| (f64::from(i), f64::from(i % 2) * 3.0)));
    assert!(pieces(&zigzag, model(), at_speed(30.0), &with_arcs(0.005)).iter().all(|p| p.arc.is_none()));
    let line = bead((0..100).map(|i| (f64::from(i) * 0.3, f64::from(i) * 0.1)));
    assert!(pieces(&line, model(), at_speed(30.0), &with_arcs(0.005)).iter().all(|p| p.arc.is_none()));
}

#[test]
fn an_s_is_taken_apart_where_it_turns() {
    let s = bead((0..=200).map(|i| {
        let angle = PI * f64::from(i) / 100.0;
        if i <= 100 {
            (100.0 - 3.0 * angle.cos(), 100.0 + 3.0 * angle.sin())
        } else {
            (106.0 + 3.0 * angle.cos(), 100.0 + 3.0 * angle.sin())
        }
    }));
    let pieces = pieces(&s, model(), at_speed(30.0), &with_arcs(0.005));
    let ways: Vec<bool> = pieces.iter().filter_map(|p| p.arc.map(|a| a.is_ccw)).collect();
    assert!(ways.contains(&true) && ways.contains(&false), "{ways:?}");
}

#[test]
fn dense_segments_are_joined_within_the_tolerance_and_the_rest_driven_slower() {
    let mut profile = profile::builtin("marlin").unwrap();
    (profile.firmware.arcs, profile.firmware.segments_per_s) = (false, 100.0);
    // Segments of 0.02 mm where 0.3 mm are wanted; the tolerance allows chords of 0.18 mm.
    let bend = ellipse(1.0, 1.0, 0.0, PI, 157);
    profile.print.tolerance_mm = 0.004;
    let made = pieces(&bend, model(), at_speed(30.0), &profile);
    assert!(made.len() < 30, "{}", made.len());
    assert!(
        farthest_from_line(&bend.iter().map(|p| p.at).collect::<Vec<_>>(), &as_line(bend[0], &made)) <= 0.004
    );
    let rate = made[8].speed_mm_s / made[8].length_mm;
    assert!(rate < 110.0, "{rate} moves a second");
    // A long segment is left alone.
    let line = bead([(0.0, 0.0), (50.0, 0.0)].into_iter());
    assert_eq!(pieces(&line, model(), at_speed(30.0), &profile)[0].speed_mm_s, 30.0);
}

fn as_line(begin: BeadPoint, pieces: &[Piece]) -> Vec<BeadPoint> {
    let ends = pieces.iter().map(|p| BeadPoint { at: p.to, width_mm: 0.4 });
    [begin].into_iter().chain(ends).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn moves_keep_within_the_tolerance_and_filament_goes_by_length(
        a in 0.8_f64..12.0, b in 0.8_f64..12.0, from in 0.0_f64..6.0, turn in -6.0_f64..6.0, n in 20_u32..300,
        tolerance in 0.002_f64..0.02,
    ) {
        // Segments far longer than the grid on which they are written.
        let turn = turn.signum() * turn.abs().max(0.02 * f64::from(n) / a.min(b));
        let line = ellipse(a, b, from, from + turn, n);
        let made = pieces(&line, model(), at_speed(30.0), &with_arcs(tolerance));
        // Written places are 0.5 um off at most.
        prop_assert!(farthest_from_line(&sampled(line[0].at, &made), &line) <= tolerance + 1e-3);
        prop_assert_eq!(made.last().map(|p| p.to), line.last().map(|p| p.at));
        for arc in made.iter().filter(|p| p.arc.is_some()) {
            // Between chord and arc there is at most the tolerance.
            let per_mm = arc.mm3 / arc.length_mm;
            prop_assert!((per_mm / 0.08 - 1.0).abs() < 0.02, "{}", per_mm);
        }
        let planned: f64 = line.windows(2).map(|l| (l[1].at - l[0].at).norm() * 0.08).sum();
        let laid: f64 = made.iter().map(|p| p.mm3).sum();
        prop_assert!((laid - planned).abs() < 1e-9);
    }
}

#[test]
fn no_bead_asks_the_hotend_for_more_than_it_melts() {
    let mut profile = with_arcs(0.005);
    profile.filament.flow_percent = 110.0;
    let speed_mm_s = 80.0;
    let straight = bead([(0.0, 0.0), (50.0, 0.0), (50.0, 50.0)].into_iter());
    for (most_mm3_s, expected_mm_s) in [(1.0, 1.0 / (0.4 * 0.2 * 1.1)), (100.0, speed_mm_s)] {
        profile.filament.max_flow_mm3_s = most_mm3_s;
        for points in [&straight, &ellipse(20.0, 20.0, 0.0, PI, 200)] {
            for piece in pieces(points, model(), at_speed(speed_mm_s), &profile) {
                assert!(
                    (piece.speed_mm_s / expected_mm_s - 1.0).abs() < 1e-3,
                    "{piece:?}, {expected_mm_s} mm/s"
                );
            }
        }
    }
}

#[test]
fn an_arc_over_long_segments_keeps_within_the_tolerance_between_their_ends_and_middles() {
    let (from, turn, tolerance) = (3.699678064124821, 5.200816819230839, 0.01688911069841229);
    let line = ellipse(7.634599418149358, 2.4352833533475993, from, from + turn, 60);
    let made = pieces(&line, model(), at_speed(30.0), &with_arcs(tolerance));
    let far = farthest_from_line(&sampled(line[0].at, &made), &line);
    assert!(far <= tolerance, "{far}");
}
