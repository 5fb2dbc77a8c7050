//! G-code of every profile on the simulated printer of its dialect: no error, no move outside the machine, the material that was
//! planned, the time that was estimated.
//!
//! The simulator runs in this process, without port and protocol: the same lines, one after the other.

#![expect(clippy::unwrap_used, reason = "a test fails where something is wrong")]
#![expect(clippy::print_stdout, reason = "what was measured is shown with --nocapture")]

mod seams;

use hil_sim::event::{Bead, Event, Summary};
use hil_sim::printer::{Options, Pace, Printer};
use lumenfab::gcode::{self, Header};
use lumenfab::geom::{Contour, Point2, Region, Vector3};
use lumenfab::model::{Facet, Model};
use lumenfab::motion::{self, Estimate};
use lumenfab::phantom::{Kind, Vessel};
use lumenfab::profile::SupportStyle;
use lumenfab::profile::{self, Profile};
use lumenfab::progress::Task;
use lumenfab::slice::{self, GridParams, Layer, LayerSlot};
use lumenfab::toolpath;

/// What a run came to.
struct Run {
    summary: Summary,
    beads: Vec<Bead>,
    complaints: Vec<String>,
}

/// Sends a job line by line, as fast as the printer takes it.
fn run(text: &str, profile: &Profile) -> Run {
    let mut printer = Printer::new(Options {
        profile: hil_sim::profile::Profile::by_name(&profile.name).unwrap(),
        baud: None,
        faults: Vec::new(),
        seed: 1,
        record_commands: false,
    });
    printer.host_arrived();
    let mut run = Run { summary: Summary::default(), beads: Vec::new(), complaints: Vec::new() };
    for line in text.lines().map(|l| l.split(';').next().unwrap().trim()).filter(|l| !l.is_empty()) {
        printer.receive(format!("{line}\n").as_bytes());
        while printer.pace() == Pace::Work && printer.step() {}
        listen(&mut printer, &mut run);
    }
    printer.receive(b"M400\n");
    while printer.pace() == Pace::Work && printer.step() {}
    listen(&mut printer, &mut run);
    run.summary = printer.summary();
    run
}

fn listen(printer: &mut Printer, run: &mut Run) {
    let said = std::mem::take(printer.output());
    let wrong = |l: &&str| {
        let l = l.to_ascii_lowercase();
        ["error", "!!", "unknown", "prevented", "warning", "fatal"].iter().any(|word| l.contains(word))
    };
    run.complaints.extend(String::from_utf8_lossy(&said).lines().filter(wrong).map(str::to_owned));
    run.beads.extend(printer.take_events().filter_map(|event| match event {
        Event::Bead(bead) => Some(bead),
        _ => None,
    }));
}

/// A leaning, branching vessel wall of two rings that merge, n layers of 0.2 mm.
fn vessel(n_layers: usize) -> Vec<Layer> {
    let layer = |i: usize| {
        let lean = 0.02 * i as f64;
        let apart = 5.0 + 0.06 * i as f64;
        let ring = |sign: f64, radius: f64| {
            let centre = Point2::new(lean + sign * apart / 2.0, 0.3 * lean);
            Region::new(vec![Contour::circle(centre, radius, 90)])
        };
        let outer = ring(-1.0, 3.5).union(&ring(1.0, 2.9));
        let lumen = ring(-1.0, 2.5).union(&ring(1.0, 1.9));
        Layer {
            slot: LayerSlot {
                z_mid_mm: 0.2 * i as f64 + 0.1,
                height_mm: 0.2,
                ct_plane: i.is_multiple_of(15).then_some(i / 15),
            },
            material: outer.difference(&lumen),
            lumen,
        }
    };
    (0..n_layers).map(layer).collect()
}

/// The carotid of the phantom from end to end, with a wall of 1 mm, in layers of 0.3 mm.
fn carotid() -> Vec<Layer> {
    let vessel = Vessel::new(Kind::Carotid);
    let layer = |i: u32| {
        let z_mid_mm = 0.3 * (f64::from(i) + 0.5);
        let lumen = vessel.region_at(z_mid_mm, 128);
        let slot =
            LayerSlot { z_mid_mm, height_mm: 0.3, ct_plane: i.is_multiple_of(10).then_some(i as usize / 10) };
        Layer { slot, material: lumen.offset(1.0, 0.002).difference(&lumen), lumen }
    };
    (0..450).map(layer).collect()
}

/// Another program's model: a solid rod of 24 corners, as a mesh.
fn rod() -> Vec<Layer> {
    let at = |k: u8, z: f32| {
        let angle = std::f32::consts::TAU * f32::from(k % 24) / 24.0;
        [12.0 * angle.cos(), 7.0 * angle.sin(), z]
    };
    let facets: Vec<Facet> = (0..24)
        .flat_map(|k| {
            let (a, b, c, d) = (at(k, 0.0), at(k + 1, 0.0), at(k + 1, 3.0), at(k, 3.0));
            [[a, b, c], [a, c, d], [[0.0, 0.0, 3.0], d, c], [[0.0, 0.0, 0.0], b, a]]
        })
        .collect();
    let params = GridParams { layer_mm: 0.2, height_limits_mm: [0.1, 0.3] };
    slice::slice_mesh(&Model::of(&facets).unwrap().mesh, &params, &Task::quiet()).unwrap().layers
}

/// A tube that leans by 60 degrees from the vertical.
fn leaning_tube(n_layers: usize) -> Vec<Layer> {
    let layer = |i: usize| {
        let centre = Point2::new(0.2 * 60f64.to_radians().tan() * i as f64, 0.0);
        let disc = |radius: f64| Region::new(vec![Contour::circle(centre, radius, 120)]);
        let slot = LayerSlot { z_mid_mm: 0.2 * i as f64 + 0.1, height_mm: 0.2, ct_plane: None };
        Layer { slot, material: disc(4.0).difference(&disc(3.0)), lumen: disc(3.0) }
    };
    (0..n_layers).map(layer).collect()
}

/// A slab with a hole: long straight lines, much raster.
fn slab(n_layers: usize) -> Vec<Layer> {
    let square = |half: f64| {
        Contour::new(
            [(-1., -1.), (1., -1.), (1., 1.), (-1., 1.)].map(|(x, y)| Point2::new(x * half, y * half)).into(),
        )
    };
    let material = Region::new(vec![square(15.0)]).difference(&Region::new(vec![square(5.0)]));
    let layer = |i: usize| Layer {
        slot: LayerSlot { z_mid_mm: 0.2 * i as f64 + 0.1, height_mm: 0.2, ct_plane: None },
        material: material.clone(),
        lumen: Region::default(),
    };
    (0..n_layers).map(layer).collect()
}

/// A top on two piers: a span over air, and fill between a floor and a roof.
fn table() -> Vec<Layer> {
    let block = |x: [f64; 2]| {
        let corners = [(x[0], 0.0), (x[1], 0.0), (x[1], 15.0), (x[0], 15.0)];
        Region::new(vec![Contour::new(corners.map(|(x, y)| Point2::new(x, y)).into())])
    };
    let piers = block([0.0, 8.0]).union(&block([20.0, 28.0]));
    let layer = |i: u32| Layer {
        slot: LayerSlot { z_mid_mm: 0.2 * f64::from(i) + 0.1, height_mm: 0.2, ct_plane: None },
        material: if i < 15 { piers.clone() } else { block([0.0, 28.0]) },
        lumen: Region::default(),
    };
    (0..30).map(layer).collect()
}

fn job(layers: &[Layer], profile: &Profile) -> (String, Estimate, f64) {
    let planned = toolpath::plan(layers, profile, &Task::quiet()).unwrap();
    let draft = gcode::write(&planned.paths, profile, &Header::default());
    let estimate = motion::estimate(&draft, profile, &Task::quiet()).unwrap();
    let volume = planned.paths.layers.iter().map(|l| gcode::volume_mm3(l, profile)).sum();
    (gcode::timed(&draft, estimate.timing(), profile), estimate, volume)
}

fn all_profiles() -> Vec<Profile> {
    profile::builtin_names().into_iter().map(|name| profile::builtin(name).unwrap()).collect()
}

#[test]
fn every_profile_prints_on_its_own_firmware_without_error() {
    for profile in all_profiles() {
        let (text, _, planned_mm3) = job(&vessel(40), &profile);
        let run = run(&text, &profile);
        assert!(
            run.complaints.is_empty(),
            "{}: {:?}",
            profile.name,
            &run.complaints[..run.complaints.len().min(5)]
        );
        let s = &run.summary;
        assert_eq!(
            (s.unknown_commands, s.soft_endstop_hits, s.cold_extrusions),
            (0, 0, 0),
            "{}",
            profile.name
        );
        assert_eq!((s.layers, s.last_state.as_str()), (40, "idle"), "{}", profile.name);
        assert_eq!((s.hotend_c[1], s.bed_c[1]), (0.0, 0.0), "{}: heaters stay on", profile.name);
        let deposited = s.deposited_mm3 / profile.filament.flow_percent * 100.0;
        assert!((deposited / planned_mm3 - 1.0).abs() < 1e-3, "{}: {deposited} {planned_mm3}", profile.name);
    }
}

#[test]
fn a_part_as_large_as_the_machine_is_printed_without_leaving_it() {
    for mut profile in all_profiles() {
        let [x, y, z] = profile.machine.bed_mm;
        // As high as it goes: the last layer's top is the machine's.
        let n_layers = 30;
        let height_mm = profile.machine.layer_height_mm[1];
        profile.machine.bed_mm[2] = f64::from(n_layers) * height_mm + 1e-6;
        let shrinks = 1.0 - profile.filament.shrinkage_percent / 100.0;
        let half = Vector3::new(x / 2.0 * shrinks, y / 2.0 * shrinks, z);
        let corners = [(-1., -1.), (1., -1.), (1., 1.), (-1., 1.)];
        let outer = Contour::new(corners.map(|(u, v)| Point2::new(u * half.x, v * half.y)).into());
        let inner =
            Contour::new(corners.map(|(u, v)| Point2::new(u * (half.x - 1.0), v * (half.y - 1.0))).into());
        let material = Region::new(vec![outer]).difference(&Region::new(vec![inner]));
        let layer = |i: i32| Layer {
            slot: LayerSlot { z_mid_mm: (f64::from(i) + 0.5) * height_mm, height_mm, ct_plane: None },
            material: material.clone(),
            lumen: Region::default(),
        };
        let (text, _, _) = job(&(0..n_layers).map(layer).collect::<Vec<_>>(), &profile);
        let run = run(&text, &profile);
        assert!(run.complaints.is_empty(), "{}: {:?}", profile.name, run.complaints.first());
        assert_eq!(run.summary.soft_endstop_hits, 0, "{}", profile.name);
        let highest = profile.machine.bed_mm[2];
        let moves = text.lines().filter(|l| l.starts_with('G'));
        let heights = moves.filter_map(|l| gcode::reader::parse(l).unwrap().command?.value('Z'));
        let reached = heights.fold(0.0, f64::max);
        assert!((highest - 1e-3..=highest).contains(&reached), "{}: {reached} of {highest}", profile.name);
    }
}

#[test]
fn the_estimate_is_within_three_percent_of_the_simulator_s_time() {
    println!(
        "{:16} {:8} {:>10} {:>10} {:>8} {:>10} {:>10} {:>8}",
        "profile", "job", "moves s", "simulated", "%", "all s", "simulated", "%"
    );
    let (carotid, rod, slab) = (carotid(), rod(), slab(10));
    for profile in all_profiles() {
        for (job_name, layers) in [("carotid", &carotid), ("rod", &rod), ("slab", &slab)] {
            let (text, estimate, _) = job(layers, &profile);
            let run = run(&text, &profile);
            let off = |ours: f64, theirs: f64| 100.0 * (ours / theirs - 1.0);
            let moves = off(estimate.total_s - estimate.waiting_s, run.summary.moving_s);
            let all = off(estimate.total_s, run.summary.simulated_s);
            println!(
                "{:16} {job_name:8} {:10.1} {:10.1} {moves:8.2} {:10.1} {:10.1} {all:8.2}",
                profile.name,
                estimate.total_s - estimate.waiting_s,
                run.summary.moving_s,
                estimate.total_s,
                run.summary.simulated_s
            );
            assert!(moves.abs() < 1.0 && all.abs() < 3.0, "{}: moves {moves} %, all {all} %", profile.name);
            let area_mm2 = std::f64::consts::FRAC_PI_4 * profile.machine.filament_mm.powi(2);
            let simulated_mm = (run.summary.deposited_mm3 + run.summary.blob_mm3) / area_mm2;
            assert!((estimate.filament_mm / simulated_mm - 1.0).abs() < 1e-3, "{}", profile.name);
        }
    }
}

#[test]
fn floors_bridges_and_rafts_run_on_every_firmware() {
    for mut profile in all_profiles() {
        (profile.print.infill_percent, profile.print.raft_layers) = (20.0, 3);
        profile.print.support = SupportStyle::None;
        let (text, estimate, planned_mm3) = job(&table(), &profile);
        let run = run(&text, &profile);
        assert!(run.complaints.is_empty(), "{}: {:?}", profile.name, run.complaints.first());
        assert_eq!((run.summary.soft_endstop_hits, run.summary.layers), (0, 33), "{}", profile.name);
        let deposited = run.summary.deposited_mm3 / profile.filament.flow_percent * 100.0;
        assert!((deposited / planned_mm3 - 1.0).abs() < 1e-3, "{}: {deposited} {planned_mm3}", profile.name);
        let off = estimate.total_s / run.summary.simulated_s - 1.0;
        assert!(off.abs() < 0.03, "{}: {off}", profile.name);
        for kind in ["Bridge infill", "Solid infill", "Internal infill", "Support material interface"] {
            assert!(text.contains(&format!(";TYPE:{kind}\n")), "{}: {kind}", profile.name);
        }
    }
}

#[test]
fn supports_are_printed_and_named() {
    for name in ["prusa-mk3s", "klipper"] {
        let mut profile = profile::builtin(name).unwrap();
        profile.print.support = SupportStyle::Column;
        let (text, _, planned_mm3) = job(&leaning_tube(40), &profile);
        let run = run(&text, &profile);
        assert!(run.complaints.is_empty(), "{name}: {:?}", run.complaints.first());
        assert!((run.summary.deposited_mm3 / planned_mm3 - 1.0).abs() < 1e-3, "{name}");
        for kind in [";TYPE:Support material\n", ";TYPE:Support material interface\n"] {
            assert!(text.contains(kind), "{name}: {kind}");
        }
    }
}

#[test]
fn ribs_are_printed_on_every_firmware() {
    // Two thin tubes far apart: each wants a rib at 6.4 mm and gets a post.
    let layer = |i: usize| {
        let discs = |radius: f64| {
            let disc = |x: f64| Region::new(vec![Contour::circle(Point2::new(x, 0.0), radius, 90)]);
            disc(0.0).union(&disc(40.0))
        };
        let slot = LayerSlot { z_mid_mm: 0.2 * i as f64 + 0.1, height_mm: 0.2, ct_plane: None };
        Layer { slot, material: discs(1.6).difference(&discs(0.8)), lumen: discs(0.8) }
    };
    let layers: Vec<Layer> = (0..45).map(layer).collect();
    for mut profile in all_profiles() {
        (profile.print.ribs, profile.print.rib_slenderness) = (true, 2.0);
        let (text, estimate, planned_mm3) = job(&layers, &profile);
        let run = run(&text, &profile);
        assert!(run.complaints.is_empty(), "{}: {:?}", profile.name, run.complaints.first());
        assert_eq!(run.summary.soft_endstop_hits, 0, "{}", profile.name);
        let deposited = run.summary.deposited_mm3 / profile.filament.flow_percent * 100.0;
        assert!((deposited / planned_mm3 - 1.0).abs() < 1e-3, "{}: {deposited} {planned_mm3}", profile.name);
        let off = estimate.total_s / run.summary.simulated_s - 1.0;
        assert!(off.abs() < 0.03, "{}: {off}", profile.name);
        assert!(text.contains(";TYPE:Support material\n"), "{}", profile.name);
    }
}

#[test]
fn arcs_are_driven_within_the_tolerance_of_what_was_planned() {
    let mut profile = profile::builtin("reprapfirmware").unwrap();
    let layers = vessel(3);
    let (with_arcs, _, _) = job(&layers, &profile);
    let planned = toolpath::plan(&layers, &profile, &Task::quiet()).unwrap().paths;
    let n_arcs = with_arcs.lines().filter(|l| l.starts_with("G2 ") || l.starts_with("G3 ")).count();
    let driven = run(&with_arcs, &profile);
    // The tolerance holds what the firmware's chords leave the arc by; places are written in steps of 1 um.
    let allowed_mm = profile.print.tolerance_mm + 1e-3;
    let mut farthest = 0.0f64;
    for bead in &driven.beads {
        let layer = planned.layers.iter().find(|l| (l.z_mm - bead.to_mm[2]).abs() < 1e-6).unwrap();
        let middle = [0, 1].map(|i| (bead.from_mm[i] + bead.to_mm[i]) / 2.0);
        for [x, y] in [[bead.to_mm[0], bead.to_mm[1]], middle] {
            let segments = layer.beads.iter().flat_map(|b| b.points.windows(2));
            let off = segments
                .map(|s| distance_mm(Point2::new(x, y), s[0].at, s[1].at))
                .fold(f64::INFINITY, f64::min);
            farthest = farthest.max(off);
        }
    }
    profile.firmware.arcs = false;
    let (without, _, _) = job(&layers, &profile);
    println!(
        "{n_arcs} arcs, {} lines instead of {}, {farthest:.4} mm off at most ({} mm allowed)",
        with_arcs.lines().count(),
        without.lines().count(),
        profile.print.tolerance_mm
    );
    assert!(n_arcs > 20 && farthest <= allowed_mm, "{n_arcs} arcs, {farthest} mm");
    // And the other way: nothing that was planned is left out, and each layer has its material.
    for layer in &planned.layers {
        let own = driven.beads.iter().filter(|b| (b.to_mm[2] - layer.z_mm).abs() < 1e-6);
        let at = |mm: [f64; 3]| Point2::new(mm[0], mm[1]);
        let chords: Vec<_> = own.clone().map(|b| (at(b.from_mm), at(b.to_mm))).collect();
        for pair in layer.beads.iter().flat_map(|b| b.points.windows(2)) {
            for p in [pair[0].at, pair[1].at, Point2::from((pair[0].at.coords + pair[1].at.coords) / 2.0)] {
                let off = chords.iter().map(|c| distance_mm(p, c.0, c.1)).fold(f64::INFINITY, f64::min);
                assert!(off <= allowed_mm, "{off} mm at {p} in the layer at {}", layer.z_mm);
            }
        }
        let laid: f64 = own.map(|b| b.volume_mm3).sum();
        let meant = gcode::volume_mm3(layer, &profile) * profile.filament.flow_percent / 100.0;
        assert!((laid / meant - 1.0).abs() < 1e-3, "{laid} mm3 of {meant} in the layer at {}", layer.z_mm);
    }
    assert!(with_arcs.lines().count() < without.lines().count());
}

fn distance_mm(p: Point2, a: Point2, b: Point2) -> f64 {
    let along = b - a;
    let t = ((p - a).dot(&along) / along.norm_squared().max(1e-18)).clamp(0.0, 1.0);
    (p - a - along * t).norm()
}

#[test]
fn moves_come_no_denser_than_the_profile_says() {
    let profile = profile::builtin("marlin").unwrap();
    let (text, _, _) = job(&carotid()[..20], &profile);
    let run = run(&text, &profile);
    // Over as many moves as the planner holds, each run of beads by itself.
    let window = profile.firmware.planner_moves;
    let mut densest = 0.0f64;
    for beads in run.beads.windows(window) {
        let is_one_run = beads.windows(2).all(|p| p[0].to_mm == p[1].from_mm);
        let seconds = beads[window - 1].t_s - beads[0].t_s;
        if is_one_run && seconds > 0.0 {
            densest = densest.max((window - 1) as f64 / seconds);
        }
    }
    println!("{densest:.0} moves a second at most, {} allowed", profile.firmware.segments_per_s);
    // Speeds are written in mm/min.
    assert!(densest > 0.0 && densest <= 1.01 * profile.firmware.segments_per_s, "{densest}");
}

#[test]
fn the_same_job_has_the_same_bytes_on_any_number_of_threads() {
    let mut plain = profile::builtin("prusa-mk3s").unwrap();
    plain.firmware.arcs = true;
    let mut held = plain.clone();
    (held.print.infill_percent, held.print.raft_layers) = (20.0, 2);
    held.print.support = SupportStyle::Column;
    for (layers, profile) in [(leaning_tube(20), plain), (leaning_tube(30), held.clone()), (table(), held)] {
        let on = |n_threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
            pool.install(|| job(&layers, &profile).0)
        };
        let one = on(1);
        assert!(one == on(2) && one == on(4) && one == on(1));
    }
}
