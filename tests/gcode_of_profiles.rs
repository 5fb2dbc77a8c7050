//! G-code of every profile on the simulated printer of its dialect: no error, no move outside the machine, the material that was
//! planned, the time that was estimated.
//!
//! The simulator runs in this process, without port and protocol: the same lines, one after the other.

#![expect(clippy::unwrap_used, reason = "a test fails where something is wrong")]
#![expect(clippy::print_stdout, reason = "what was measured is shown with --nocapture")]

use hil_sim::event::{Event, Summary};
use hil_sim::printer::{Options, Pace, Printer};
use lumenfab::gcode::{self, Header};
use lumenfab::geom::{Contour, Point2, Region, Vector3};
use lumenfab::motion::{self, Estimate};
use lumenfab::profile::{self, Profile};
use lumenfab::progress::Task;
use lumenfab::slice::{Layer, LayerSlot};
use lumenfab::toolpath;

/// What a run came to.
struct Run {
    summary: Summary,
    complaints: Vec<String>,
    /// When the first bead began and the last move ended, s.
    printing_s: [f64; 2],
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
    let mut run = Run { summary: Summary::default(), complaints: Vec::new(), printing_s: [f64::INFINITY, 0.0] };
    for line in text.lines().map(|l| l.split(';').next().unwrap().trim()).filter(|l| !l.is_empty()) {
        printer.receive(format!("{line}\n").as_bytes());
        while printer.pace() == Pace::Work && printer.step() {}
        listen(&mut printer, &mut run);
    }
    printer.receive(b"M400\n");
    while printer.pace() == Pace::Work && printer.step() {}
    listen(&mut printer, &mut run);
    run.printing_s[1] = printer.now_s();
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
    for event in printer.take_events() {
        if let Event::Bead(bead) = event {
            run.printing_s[0] = run.printing_s[0].min(bead.t_s);
        }
    }
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

/// A slab with a hole, as another program's model might be: long straight lines, much raster.
fn slab(n_layers: usize) -> Vec<Layer> {
    let square = |half: f64| {
        Contour::new([(-1., -1.), (1., -1.), (1., 1.), (-1., 1.)].map(|(x, y)| Point2::new(x * half, y * half)).into())
    };
    let material = Region::new(vec![square(15.0)]).difference(&Region::new(vec![square(5.0)]));
    let layer = |i: usize| Layer {
        slot: LayerSlot { z_mid_mm: 0.2 * i as f64 + 0.1, height_mm: 0.2, ct_plane: None },
        material: material.clone(),
        lumen: Region::default(),
    };
    (0..n_layers).map(layer).collect()
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
        assert!(run.complaints.is_empty(), "{}: {:?}", profile.name, &run.complaints[..run.complaints.len().min(5)]);
        let s = &run.summary;
        assert_eq!((s.unknown_commands, s.soft_endstop_hits, s.cold_extrusions), (0, 0, 0), "{}", profile.name);
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
        let inner = Contour::new(corners.map(|(u, v)| Point2::new(u * (half.x - 1.0), v * (half.y - 1.0))).into());
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
    println!("{:16} {:>10} {:>10} {:>8} {:>10} {:>10} {:>8}", "profile", "moves s", "simulated", "%", "all s", "simulated", "%");
    for profile in all_profiles() {
        for layers in [vessel(40), slab(10)] {
            let (text, estimate, _) = job(&layers, &profile);
            let run = run(&text, &profile);
            let off = |ours: f64, theirs: f64| 100.0 * (ours / theirs - 1.0);
            let moves = off(estimate.total_s - estimate.waiting_s, run.summary.moving_s);
            let all = off(estimate.total_s, run.summary.simulated_s);
            println!(
                "{:16} {:10.1} {:10.1} {moves:8.2} {:10.1} {:10.1} {all:8.2}",
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
