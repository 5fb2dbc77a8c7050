use super::*;
use proptest::prelude::*;

const LIMITS: Limits = Limits {
    max_speed: [500.0, 500.0, 10.0, 60.0],
    max_acceleration: [3000.0, 3000.0, 100.0, 5000.0],
    print_acceleration: 1000.0,
    retract_acceleration: 3000.0,
    travel_acceleration: 1500.0,
    travel_max_acceleration: None,
    cornering: Cornering::Deviation(0.013),
};

/// Drives through all points as one queue, at most 15 moves known; the total time and the finished moves.
fn drive(points: &[Position], speed: f64) -> (f64, Vec<Block>) {
    let mut planner = Planner::new(16);
    let mut done = Vec::new();
    let mut finish = |planner: &mut Planner| {
        planner.release(0.0);
        if planner.next_end_s().is_none() {
            planner.start();
        }
        done.extend(planner.finish());
    };
    for pair in points.windows(2) {
        while planner.free() == 0 {
            finish(&mut planner);
        }
        planner.push(0.0, [pair[0], pair[1]], speed, &LIMITS);
    }
    while planner.depth() > 0 {
        finish(&mut planner);
    }
    (planner.free_s, done)
}

#[test]
fn one_move_takes_the_time_of_its_trapezoid() {
    // 100 mm at 100 mm/s and 1500 mm/s²: s/v + v/a.
    let (time, _) = drive(&[[0.0; 4], [100.0, 0.0, 0.0, 0.0]], 100.0);
    assert!((time - (1.0 + 100.0 / 1500.0)).abs() < 1e-9, "{time}");
    // 2 mm are too short for 100 mm/s: 2 sqrt(s/a).
    let (time, _) = drive(&[[0.0; 4], [2.0, 0.0, 0.0, 0.0]], 100.0);
    assert!((time - 2.0 * (2.0_f64 / 1500.0).sqrt()).abs() < 1e-9, "{time}");
}

#[test]
fn straight_line_in_pieces_takes_the_time_of_one() {
    let points: Vec<Position> =
        (0..=200).map(|i| [f64::from(i) * 0.5, 0.0, 0.0, f64::from(i) * 0.02]).collect();
    let (time, _) = drive(&points, 60.0);
    // 15 moves of 0.5 mm are enough to stop from 60 mm/s at 1000 mm/s² (1.8 mm).
    assert!((time / (100.0 / 60.0 + 60.0 / 1000.0) - 1.0).abs() < 1e-9, "{time}");
}

#[test]
fn right_angle_is_taken_at_the_junction_speed() {
    let corner = [[0.0; 4], [50.0, 0.0, 0.0, 0.0], [50.0, 50.0, 0.0, 0.0]];
    let (time, done) = drive(&corner, 100.0);
    let half_sine = 0.5_f64.sqrt();
    let v2 = 1500.0 * 0.013 * half_sine / (1.0 - half_sine);
    let ramp = |from2: f64| 100.0_f64.mul_add(100.0, -from2) / 3000.0;
    let expected =
        2.0 * ((100.0 - v2.sqrt()) / 1500.0 + 100.0 / 1500.0 + (50.0 - ramp(v2) - ramp(0.0)) / 100.0);
    assert!((time / expected - 1.0).abs() < 1e-9, "{time} {expected}");
    assert_eq!(done.len(), 2);
}

/// When all that it holds has ended, s.
fn drained_s(mut planner: Planner) -> f64 {
    planner.release(0.0);
    while planner.depth() > 0 {
        planner.start();
        planner.finish();
    }
    planner.free_s
}

/// Time of two moves of 50 mm with a right angle between them.
fn right_angle_s(cornering: Cornering) -> f64 {
    let limits = Limits { cornering, ..LIMITS };
    let mut planner = Planner::new(16);
    planner.push(0.0, [[0.0; 4], [50.0, 0.0, 0.0, 0.0]], 100.0, &limits);
    planner.push(0.0, [[50.0, 0.0, 0.0, 0.0], [50.0, 50.0, 0.0, 0.0]], 100.0, &limits);
    drained_s(planner)
}

/// The same in closed form: taken at `corner` mm/s, begun and ended at `rest`.
fn expected_s(rest: f64, corner: f64) -> f64 {
    let (v, a) = (100.0_f64, LIMITS.travel_acceleration);
    let ramps = 2.0f64.mul_add(v * v, -rest * rest - corner * corner) / (2.0 * a);
    2.0 * ((2.0 * v - rest - corner) / a + (50.0 - ramps) / v)
}

#[test]
fn every_rule_of_corners_takes_a_right_angle_at_its_own_speed() {
    let jerk = [8.0; 4];
    let half_sine = 0.5_f64.sqrt();
    for (cornering, rest, corner) in [
        (Cornering::ClassicJerk { axes: jerk, from_prusa: false }, 8.0, 8.0),
        // With one move before it, Prusa's second move does not join the first.
        (Cornering::ClassicJerk { axes: jerk, from_prusa: true }, 8.0, 8.0),
        (Cornering::InstantChange(jerk), 0.0, 8.0),
        // 8 / (100 sqrt 2) of 100 mm/s.
        (Cornering::PlanarJerk(jerk), 4.0, 8.0 / 2.0_f64.sqrt()),
        (Cornering::SmoothieDeviation(0.05), 0.0, (1500.0 * 0.05 * half_sine / (1.0 - half_sine)).sqrt()),
        // 5 mm/s hold at 1000 mm/s², the toolhead's; the move has 1500.
        (Cornering::SquareCorner { speed: 5.0, cruise_ratio: 0.0 }, 0.0, 5.0 * 1.5_f64.sqrt()),
    ] {
        let (time, expected) = (right_angle_s(cornering), expected_s(rest, corner));
        assert!((time / expected - 1.0).abs() < 1e-9, "{cornering:?}: {time} {expected}");
    }
}

/// Time of 50 mm at 30 mm/s and then 50 mm at 100 mm/s straight on, the second with `e` mm of filament.
fn speed_up_s(cornering: Cornering, e: [f64; 2]) -> f64 {
    let limits = Limits { cornering, print_acceleration: 1500.0, ..LIMITS };
    let mut planner = Planner::new(16);
    let points = [[0.0; 4], [50.0, 0.0, 0.0, e[0]], [100.0, 0.0, 0.0, e[0] + e[1]]];
    for (pair, speed) in points.windows(2).zip([30.0, 100.0]) {
        planner.push(0.0, [pair[0], pair[1]], speed, &limits);
    }
    drained_s(planner)
}

/// The same in closed form: begun and ended at `rest`, joined at `corner`.
fn speed_up_expected_s(rest: f64, corner: f64) -> f64 {
    let leg = |v: f64| {
        let a = 1500.0;
        (2.0 * v - rest - corner) / a + (50.0 - (2.0 * v * v - rest * rest - corner * corner) / (2.0 * a)) / v
    };
    leg(30.0) + leg(100.0)
}

#[test]
fn straight_on_and_faster_is_joined_as_each_firmware_joins_it() {
    let jerk = [8.0; 4];
    for (cornering, e, rest, corner) in [
        (Cornering::Deviation(0.013), [0.0, 0.0], 0.0, 30.0),
        (Cornering::SmoothieDeviation(0.05), [0.0, 0.0], 0.0, 30.0),
        // The faster move counts with its full speed: 8 of 70, no more than a start from rest.
        (Cornering::ClassicJerk { axes: jerk, from_prusa: false }, [0.0, 0.0], 8.0, 8.0),
        (Cornering::InstantChange(jerk), [0.0, 0.0], 0.0, 30.0),
        // Printing and travelling do not join.
        (Cornering::InstantChange(jerk), [1.0, 0.0], 0.0, 0.0),
        // 20 of 70, but half of 20 at least.
        (Cornering::PlanarJerk([20.0; 4]), [0.0, 0.0], 10.0, 10.0),
    ] {
        let (time, expected) = (speed_up_s(cornering, e), speed_up_expected_s(rest, corner));
        assert!((time / expected - 1.0).abs() < 1e-9, "{cornering:?}: {time} {expected}");
    }
}

#[test]
fn small_segments_are_taken_as_pieces_of_an_arc() {
    // A circle of 5 mm radius in pieces of 0.5 mm: v² = length a / turn = r a, nearly.
    let n = 62;
    let points: Vec<Position> = (0..=n)
        .map(|i| {
            let angle = std::f64::consts::TAU * f64::from(i) / f64::from(n);
            [5.0 * angle.cos(), 5.0 * angle.sin(), 0.0, 0.0]
        })
        .collect();
    let (_, done) = drive(&points, 300.0);
    let fastest = done.iter().map(|block| block.max_entry2).fold(0.0, f64::max).sqrt();
    let expected = (5.0_f64 * 1500.0).sqrt();
    assert!((fastest / expected - 1.0).abs() < 0.01, "{fastest} {expected}");
}

#[test]
fn reversal_stops() {
    let there_and_back = [[0.0; 4], [30.0, 0.0, 0.0, 0.0], [0.0; 4]];
    let (time, _) = drive(&there_and_back, 100.0);
    assert!((time - 2.0 * (0.3 + 100.0 / 1500.0)).abs() < 1e-9, "{time}");
}

#[test]
fn axis_limits_slow_the_whole_move() {
    let (time, _) = drive(&[[0.0; 4], [0.0, 0.0, 10.0, 0.0]], 100.0);
    assert!((time - (1.0 + 10.0 / 100.0)).abs() < 1e-9, "{time}");
    let (time, _) = drive(&[[0.0; 4], [0.0, 0.0, 0.0, 5.0]], 35.0);
    assert!((time - (5.0 / 35.0 + 35.0 / 3000.0)).abs() < 1e-9, "{time}");
}

#[test]
fn stop_leaves_what_was_driven() {
    let mut planner = Planner::new(16);
    planner.push(0.0, [[0.0; 4], [100.0, 0.0, 0.0, 4.0]], 50.0, &LIMITS);
    planner.release(0.0);
    planner.start();
    let block = planner.stop(1.025).unwrap();
    // 1.25 mm in the first 0.05 s, then 50 mm/s.
    assert!((block.to[0] - 50.0).abs() < 1e-9, "{:?}", block.to);
    assert!((block.to[3] - 2.0).abs() < 1e-9);
    assert_eq!(planner.depth(), 0);
}

#[test]
fn lone_move_waits_for_company() {
    let mut planner = Planner::new(16);
    planner.push(5.0, [[0.0; 4], [1.0, 0.0, 0.0, 0.0]], 50.0, &LIMITS);
    assert_eq!(planner.next_start_s(), Some(5.1));
    for i in 1..3 {
        let x = f64::from(i);
        planner.push(5.01, [[x, 0.0, 0.0, 0.0], [x + 1.0, 0.0, 0.0, 0.0]], 50.0, &LIMITS);
    }
    assert_eq!(planner.next_start_s(), Some(5.01));
}

proptest! {
    #[test]
    fn speeds_are_continuous_and_within_limits(
        steps in proptest::collection::vec((-5.0_f64..5.0, -5.0_f64..5.0, 0.0_f64..0.2), 1..60),
        speed in 5.0_f64..200.0,
    ) {
        let mut at = [100.0, 100.0, 0.2, 0.0];
        let mut points = vec![at];
        for (dx, dy, de) in steps {
            at = [at[0] + dx, at[1] + dy, at[2], at[3] + de];
            points.push(at);
        }
        let (_, done) = drive(&points, speed);
        let mut exit: Option<(f64, f64)> = None;
        for block in &done {
            let profile = block.profile.unwrap();
            if let Some((speed, end_s)) = exit {
                prop_assert!((profile.entry - speed).abs() < 1e-6);
                prop_assert!((profile.start_s - end_s).abs() < 1e-9);
            }
            prop_assert!(profile.peak <= speed + 1e-6);
            prop_assert!((profile.travelled(profile.end_s()) - block.length).abs() < 1e-6 * block.length.max(1.0));
            exit = Some((profile.acceleration.mul_add(-profile.decelerate_s, profile.peak), profile.end_s()));
        }
        prop_assert!(exit.is_none_or(|(speed, _)| speed.abs() < 1e-6));
    }
}
