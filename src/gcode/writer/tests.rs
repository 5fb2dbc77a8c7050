use super::*;
use crate::gcode::reader;
use crate::geom::{Region, RigidTransform, Vector3};
use crate::profile;
use crate::slice::LayerSlot;
use crate::toolpath::Compensation;

fn layer(idx: usize, beads: Vec<Bead>, travels: Vec<Travel>) -> LayerPaths {
    let z_mm = 0.2 * (idx + 1) as f64;
    let slot = LayerSlot { z_mid_mm: z_mm - 0.1, height_mm: 0.2, ct_plane: (idx == 1).then_some(7) };
    LayerPaths { slot, z_mm, beads, travels, material: Region::default(), lumen: Region::default() }
}

fn bead(kind: BeadKind, points: &[(f64, f64)]) -> Bead {
    let point = |&(x, y): &(f64, f64)| BeadPoint { at: Point2::new(x, y), width_mm: 0.437 };
    Bead { kind, points: points.iter().map(point).collect() }
}

fn job() -> Toolpaths {
    let zigzag: Vec<(f64, f64)> =
        (0..1000).map(|i| (90.0 + 0.0137 * f64::from(i), 100.0 + f64::from(i % 2))).collect();
    let far = Travel { via: vec![Point2::new(50.0, 50.0)], leaves_material: true };
    let layers = vec![
        layer(0, vec![bead(BeadKind::ExternalPerimeter, &[(90., 90.), (91., 90.)])], vec![]),
        layer(
            1,
            vec![bead(BeadKind::SolidInfill, &zigzag), bead(BeadKind::Perimeter, &[(20., 20.), (30., 20.)])],
            vec![Travel::default(), far],
        ),
    ];
    let bed_from_stack = RigidTransform::translation(Vector3::new(1.0, 2.0, 3.0));
    Toolpaths { bed_from_stack, compensation: Compensation::default(), layers }
}

/// Layers so small that each would be waited for are not, here.
fn hurried() -> Profile {
    let mut profile = profile::builtin("reference").unwrap();
    profile.print.min_layer_time_wait = false;
    profile
}

fn text() -> String {
    write(&job(), &hurried(), &Header::default())
}

#[test]
fn numbers_have_no_superfluous_zeros() {
    let show = |steps, decimals| {
        let mut text = String::new();
        number(&mut text, steps, decimals);
        text
    };
    assert_eq!(show(1500, 3), "1.5");
    assert_eq!(show(-50, 3), "-0.05");
    assert_eq!(show(0, 3), "0");
    assert_eq!(show(2000, 3), "2");
    assert_eq!(show(1800, 0), "1800");
}

#[test]
fn filament_adds_up_to_the_planned_volume() {
    let profile = profile::builtin("reference").unwrap();
    let planned: f64 = job().layers.iter().map(|l| volume_mm3(l, &profile)).sum();
    let end = text().rfind(";TYPE:Custom").unwrap();
    let e: f64 = text()[..end]
        .lines()
        .filter_map(|l| reader::parse(l).unwrap().command)
        .filter(|c| c.is('G', 1) && c.has('X') | c.has('Y'))
        .filter_map(|c| c.value('E'))
        .sum();
    let written = e * FRAC_PI_4 * 1.75 * 1.75;
    assert!((written - planned).abs() < 3e-5, "{written} {planned}");
}

#[test]
fn the_head_counts_the_filament_of_the_start_script() {
    for name in ["marlin", "reference", "klipper"] {
        let profile = profile::builtin(name).unwrap();
        let text = write(&job(), &profile, &Header::default());
        let told = |begin: &str| -> f64 {
            text.lines().find_map(|line| line.strip_prefix(begin)).unwrap().parse().unwrap()
        };
        let estimate = crate::motion::estimate(&text, &profile, &crate::progress::Task::quiet()).unwrap();
        assert!(
            (told("; filament used [mm] = ") - estimate.filament_mm).abs() < 0.006,
            "{name}: {estimate:?}"
        );
        assert!((told("; filament_g ") - estimate.filament_g).abs() < 0.006, "{name}: {estimate:?}");
    }
}

#[test]
fn every_line_can_be_read_again_and_coordinates_return() {
    let mut ends = Vec::new();
    for line in text().lines() {
        let parsed = reader::parse(line).unwrap();
        if let Some(c) = parsed.command
            && c.is('G', 1)
            && c.has('E')
            && let Some(x) = c.value('X')
        {
            ends.push(x);
        }
    }
    let planned: Vec<f64> = job()
        .layers
        .iter()
        .flat_map(|l| &l.beads)
        .flat_map(|b| b.points[1..].iter().map(|p| p.at.x))
        .collect();
    // The end script moves with filament too, without X.
    assert_eq!(ends.len(), planned.len());
    assert!(ends.iter().zip(&planned).all(|(a, b)| (a - b).abs() <= 5.0001e-4));
}

#[test]
fn comments_follow_the_contract() {
    let text = text();
    for expected in [
        ";LAYER:0\n;Z:0.2\n;HEIGHT:0.2\n",
        ";LAYER:1\n;Z:0.4\n;HEIGHT:0.2\n;CT_PLANE:7\n",
        ";TYPE:External perimeter\n",
        ";TYPE:Solid infill\n",
        "; bed_from_stack_mm 1.000000,2.000000,3.000000\n",
        "M106 S255\n",
    ] {
        assert!(text.contains(expected), "{expected}");
    }
}

#[test]
fn a_job_without_a_ct_says_nothing_of_one() {
    let mut job = job();
    job.layers.iter_mut().for_each(|l| l.slot.ct_plane = None);
    let text = write(&job, &profile::builtin("reference").unwrap(), &Header::default());
    assert!(text.contains("\n; layers 2\n; model_shift_mm 1.000000,2.000000,3.000000\n"));
    assert!(!text.contains("CT") && !text.contains("stack"));
}

#[test]
fn only_travels_through_air_are_retracted() {
    let text = text();
    assert_eq!(text.matches("G1 E-0.8 F2100\n").count(), 1);
    assert_eq!(text.matches("G1 E0.8").count(), 1);
    let retract = text.find("G1 E-0.8").unwrap();
    assert!(text[retract..].starts_with("G1 E-0.8 F2100\nG0 Z0.6 F"), "{}", &text[retract..retract + 40]);
}

#[test]
fn a_wipe_goes_back_and_forth_and_draws_back_all_of_the_filament() {
    let mut profile = hurried();
    profile.print.wipe_mm = 2.0;
    let text = write(&job(), &profile, &Header::default());
    let back: Vec<_> = text
        .lines()
        .filter_map(|l| reader::parse(l).unwrap().command)
        .filter(|c| c.is('G', 1) && c.value('E').is_some_and(|e| e < 0.0) && c.value('E') != Some(-2.0))
        .collect();
    let drawn: f64 = back.iter().filter_map(|c| c.value('E')).sum();
    assert!((drawn + 0.8).abs() < 1e-9, "{drawn}");
    // The zigzag's last millimetre, there and back.
    let ways: Vec<_> = back.iter().filter_map(|c| c.value('Y')).collect();
    assert_eq!(ways, [100.0, 101.0]);
}

#[test]
fn the_fan_follows_the_time_of_the_layer() {
    let mut profile = profile::builtin("reference").unwrap();
    let filament = &mut profile.filament;
    (filament.fan_percent, filament.fan_least_percent) = (100.0, 20.0);
    (filament.fan_layer_time_s, filament.fan_from_layer) = ([10.0, 50.0], 2);
    let fan = |idx, time_s| cool::fan_percent(idx, time_s, &profile);
    assert_eq!([fan(0, 5.0), fan(1, 5.0), fan(2, 5.0)], [0.0, 0.0, 100.0]);
    assert!((fan(9, 30.0) - 60.0).abs() < 1e-9 && (fan(9, 400.0) - 20.0).abs() < 1e-9);
}

#[test]
fn the_object_is_labelled_in_each_layer_and_limits_are_set_before_it() {
    let text = text();
    assert_eq!((text.matches("M486 S0\n").count(), text.matches("M486 S-1\n").count()), (2, 2));
    let limits = text.find("M204 P1000 R3000 T1500\n").unwrap();
    assert!(limits < text.find("M486 T1\n").unwrap() && limits < text.find(";LAYER:0").unwrap());
}

#[test]
fn short_layers_are_slowed_down_to_the_slowest_speed() {
    let profile = profile::builtin("reference").unwrap();
    let text = text();
    let first = &text[text.find(";LAYER:0").unwrap()..text.find(";LAYER:1").unwrap()];
    let slowest = mm_min_from_mm_s(profile.print.min_speed_mm_s);
    assert!(first.contains(&format!("F{slowest}\n")), "{first}");
}

/// Speeds of the beads' moves in a layer, and how long these take, by the text: mm/s, s.
fn driven(text: &str, layer: usize) -> (Vec<f64>, f64) {
    let begin = text.find(&format!(";LAYER:{layer}\n")).unwrap();
    let (mut at, mut speed_mm_s) = ([0.0, 0.0], 0.0);
    let (mut speeds, mut time_s) = (Vec::new(), 0.0);
    for command in
        text[begin..].lines().take_while(|l| *l != ";TYPE:Custom").map(|l| reader::parse(l).unwrap())
    {
        let Some(c) = command.command else { continue };
        let to = [c.value('X').unwrap_or(at[0]), c.value('Y').unwrap_or(at[1])];
        speed_mm_s = c.value('F').map_or(speed_mm_s, |f| f / 60.0);
        let length_mm = (to[0] - at[0]).hypot(to[1] - at[1]);
        if c.is('G', 1) && c.value('E') > Some(0.0) && length_mm > 0.0 {
            speeds.push(speed_mm_s);
            time_s += length_mm / speed_mm_s;
        }
        at = to;
    }
    (speeds, time_s)
}

/// A layer of a line of 100 mm and of a small loop, upon another one, on a machine whose hotend melts that much.
fn slow_to_melt(max_flow_mm3_s: f64, change: impl Fn(&mut Profile)) -> String {
    let mut profile = profile::builtin("reference").unwrap();
    profile.filament.max_flow_mm3_s = max_flow_mm3_s;
    (profile.print.small_loop_mm, profile.print.small_loop_mm_s) = (12.0, 15.0);
    change(&mut profile);
    let line = bead(BeadKind::SolidInfill, &[(20., 20.), (120., 20.)]);
    let square =
        bead(BeadKind::ExternalPerimeter, &[(50., 50.), (52., 50.), (52., 52.), (50., 52.), (50., 50.)]);
    let layers = vec![layer(0, vec![line.clone()], vec![]), layer(1, vec![line, square], vec![])];
    write(&Toolpaths { layers, ..job() }, &profile, &Header::default())
}

#[test]
fn a_short_layer_is_slowed_down_below_what_the_hotend_melts() {
    let area_mm2 = 0.437 * 0.2;
    // What the hotend melts: slower than all speeds, than that of the line alone, than none.
    for melted_mm_s in [10.0, 40.0, 1000.0f64] {
        let full_mm_s = [melted_mm_s.min(60.0), melted_mm_s.min(15.0)];
        let full_s = 100.0 / full_mm_s[0] + 8.0 / full_mm_s[1];
        for least_s in [0.5 * full_s, 2.0 * full_s, 4.0 * full_s] {
            let text = slow_to_melt(melted_mm_s * area_mm2, |p| {
                (p.print.min_layer_time_s, p.print.min_speed_mm_s) = (least_s, 0.5);
            });
            let (speeds, time_s) = driven(&text, 1);
            let expected_s = full_s.max(least_s);
            assert!((time_s / expected_s - 1.0).abs() < 0.01, "{time_s} s of {expected_s}, {speeds:?}");
            let most = melted_mm_s + 0.01;
            assert!(speeds.iter().all(|&s| s <= most), "{speeds:?} mm/s, {melted_mm_s} can be melted");
        }
    }
}

#[test]
fn the_fan_goes_by_the_time_that_the_layer_takes_at_the_slowest_speed() {
    // 100 mm at 10 mm/s, and 8 mm at 10; four times as long is asked for, 8 mm/s are allowed: 13.5 s.
    let text = slow_to_melt(10.0 * 0.437 * 0.2, |p| {
        (p.print.min_layer_time_s, p.print.min_speed_mm_s) = (40.0, 8.0);
        (p.filament.fan_percent, p.filament.fan_least_percent) = (100.0, 0.0);
        p.filament.fan_layer_time_s = [3.5, 23.5];
    });
    let (speeds, time_s) = driven(&text, 1);
    assert!(speeds.iter().all(|s| (s - 8.0).abs() < 0.01) && (time_s - 13.5).abs() < 0.02, "{speeds:?}");
    assert!(text[text.find(";LAYER:1").unwrap()..].contains("M106 S127\n"), "half of the way between");
}

#[test]
fn other_settings_give_another_hash_and_the_same_ones_the_same_bytes() {
    assert_eq!(text(), text());
    let other =
        write(&job(), &hurried(), &Header { settings: "wall_mm = 2".to_owned(), ..Header::default() });
    assert_ne!(text().lines().nth(1), other.lines().nth(1));
}

#[test]
fn a_bridge_is_laid_at_its_own_speed_under_its_own_fan() {
    let mut profile = profile::builtin("reference").unwrap();
    (profile.print.min_layer_time_s, profile.print.bridge_mm_s) = (0.0, 17.0);
    (profile.filament.fan_percent, profile.filament.fan_least_percent) = (40.0, 40.0);
    let line = |kind, y| bead(kind, &[(20.0, y), (40.0, y)]);
    let beads = [BeadKind::SolidInfill, BeadKind::Bridge, BeadKind::SolidInfill];
    let beads = beads.iter().zip([20.0, 30.0, 40.0]).map(|(&kind, y)| line(kind, y)).collect();
    let layers = vec![layer(0, vec![line(BeadKind::SolidInfill, 20.0)], vec![]), layer(1, beads, vec![])];
    let job = Toolpaths { layers, ..job() };
    let text = write(&job, &profile, &Header::default());
    let second = &text[text.find(";LAYER:1").unwrap()..];
    let told: Vec<&str> =
        second.lines().filter(|l| l.starts_with("M106") || l.starts_with(";TYPE")).collect();
    let [solid, bridge] = [";TYPE:Solid infill", ";TYPE:Bridge infill"];
    assert_eq!(told[..6], ["M106 S102", solid, "M106 S255", bridge, "M106 S102", solid]);
    assert!(second.contains(" F1020\n") && second.contains(" F3600\n"), "{second}");
}

#[test]
fn a_small_loop_is_driven_at_its_own_speed() {
    let mut profile = profile::builtin("reference").unwrap();
    (profile.print.small_loop_mm, profile.print.small_loop_mm_s) = (8.0, 11.0);
    let circle = |radius: f64| {
        let at = |i: u32| (f64::from(i) / 24.0 * std::f64::consts::TAU).sin_cos();
        let points: Vec<(f64, f64)> =
            (0..=24).map(at).map(|(s, c)| (50.0 + radius * c, 50.0 + radius * s)).collect();
        bead(BeadKind::ExternalPerimeter, &points)
    };
    let short_line =
        bead(BeadKind::ExternalPerimeter, &[(20.0, 20.0), (21.0, 20.0), (22.0, 20.0), (23.0, 20.0)]);
    for (bead, expected_mm_s) in [(circle(1.2), 11.0), (circle(1.4), 30.0), (short_line, 30.0)] {
        assert!((speed(&bead, &profile, false) - expected_mm_s).abs() < 1e-9, "{expected_mm_s}");
    }
}

/// A small square ring in each of three layers, in a machine of 220 mm.
fn rod(change: impl Fn(&mut Profile)) -> (String, Profile) {
    let mut profile = profile::builtin("marlin").unwrap();
    change(&mut profile);
    let ring = |r: f64| [(-r, -r), (r, -r), (r, r), (-r, r), (-r, -r)].map(|(x, y)| (110.0 + x, 110.0 + y));
    let square = bead(BeadKind::ExternalPerimeter, &ring(2.0));
    let contour =
        |r: f64| crate::geom::Contour::new(ring(r)[..4].iter().map(|&(x, y)| Point2::new(x, y)).collect());
    let layers = (0..3).map(|idx| LayerPaths {
        lumen: Region::new(vec![contour(1.5)]),
        ..layer(idx, vec![square.clone()], vec![Travel::default()])
    });
    let layers = layers.collect();
    (write(&Toolpaths { layers, ..job() }, &profile, &Header::default()), profile)
}

#[test]
fn a_layer_that_is_too_short_at_the_slowest_speed_is_waited_for_beside_the_part() {
    for name in ["marlin", "klipper", "reprapfirmware", "smoothie"] {
        let (text, profile) = rod(|p| *p = profile::builtin(name).unwrap());
        let task = crate::progress::Task::quiet();
        let took = crate::motion::estimate(&text, &profile, &task).unwrap().layer_s;
        let least_s = profile.print.min_layer_time_s;
        // The nozzle comes back from its place within the next layer's time, and the last layer's end parks it.
        assert!(took[..2].iter().all(|s| (least_s - 0.1..least_s + 3.0).contains(s)), "{name}: {took:?}");
        assert_eq!(text.matches("\nG4 P").count(), 2, "{name}");
        let wait = text.find("\nG4 P").unwrap();
        let before: Vec<&str> = text[..wait].lines().rev().take(3).collect();
        // Drawn back, lifted, moved off: along one axis, to 10 mm beside the ring.
        assert!(before[0].starts_with("G0 ") && before[1].starts_with("G0 Z3.2"), "{before:?}");
        let aside = reader::parse(before[0]).unwrap().command.unwrap();
        assert!(!(aside.has('X') && aside.has('Y')), "{before:?}");
        assert!(
            aside.value('X').or(aside.value('Y')).is_some_and(|c| [98.0, 122.0].contains(&c)),
            "{before:?}"
        );
        let all: f64 = text[..wait]
            .lines()
            .filter_map(|l| reader::parse(l).unwrap().command)
            .filter(|c| c.is('G', 1))
            .filter_map(|c| c.value('E'))
            .filter(|&e| e < 0.0)
            .sum();
        assert!((all + profile.print.retract_mm).abs() < 1e-9, "{name}: {all}");
    }
}

#[test]
fn what_is_drawn_back_for_a_wait_is_pushed_forward_before_the_next_bead() {
    let (text, profile) = rod(|p| p.print.wipe_mm = 0.0);
    let waited = &text[text.find("\nG4 P").unwrap()..];
    let next = waited.find(";TYPE:External").unwrap();
    let forward = format!("G1 E{} ", profile.print.retract_mm);
    assert_eq!(waited[..next].matches(&forward).count(), 1, "{}", &waited[..next]);
}

#[test]
fn no_layer_is_waited_for_where_the_profile_says_so_or_where_it_is_long_enough() {
    assert!(!rod(|p| p.print.min_layer_time_wait = false).0.contains("G4 P"));
    assert!(!rod(|p| p.print.min_layer_time_s = 0.0).0.contains("G4 P"));
    assert!(!rod(|p| p.print.min_speed_mm_s = 0.5).0.contains("G4 P"));
}

#[test]
fn the_fan_goes_by_the_time_that_is_waited_too() {
    // 16 mm at 10 mm/s and 6.4 s more; at the last layer nobody waits.
    let (text, _) = rod(|p| {
        (p.filament.fan_percent, p.filament.fan_least_percent) = (100.0, 0.0);
        p.filament.fan_layer_time_s = [0.0, 16.0];
    });
    let fans: Vec<&str> = text.lines().filter(|l| l.starts_with("M106")).collect();
    assert_eq!(fans, ["M106 S127", "M106 S229"]);
}

#[test]
fn what_can_go_slower_does_before_anything_is_waited_for() {
    // The loop is at its slowest at 8 mm/s, so the line takes all of the rest.
    let text = slow_to_melt(1000.0, |p| (p.print.min_layer_time_s, p.print.min_speed_mm_s) = (11.0, 8.0));
    let (speeds, time_s) = driven(&text, 1);
    assert!((time_s - 11.0).abs() < 0.02, "{time_s} s, {speeds:?}");
    assert!((speeds[1] - 8.0).abs() < 0.01 && (speeds[0] - 10.0).abs() < 0.02, "{speeds:?}");
}
