use super::*;
use crate::printer::protocol::Heater;
use std::io::Cursor;

const HEAD: &str = "M104 S210\nM140 S60\nG28\nG90\nM83\nG1 X10 Y10 Z0.2 F3000\n";

fn profile() -> Profile {
    crate::profile::builtin("marlin").unwrap()
}

/// A head of six lines, then so many beads to the right, 1 mm each, all at one height.
fn job(n_beads: u32, tail: &str) -> Job<Cursor<Vec<u8>>> {
    let mut text = HEAD.to_owned();
    for i in 1..=n_beads {
        text += &format!("G1 X{} E0.05\n", 10 + i);
    }
    Job::from_text(text + tail, "j", &profile().firmware).unwrap()
}

fn known(n_sent: u64, n_acked: u64, n_certain: u64) -> Known {
    let track = Track {
        first_number: 1,
        prelude: vec!["M155 S2".into()],
        n_before: 0,
        n_twice: 0,
        ..Track::default()
    };
    let progress =
        Progress { number: n_sent + 1, n_sent, n_acked, n_certain, n_begun: n_sent, ..Progress::default() };
    Known { track, progress, is_behind: false, away_s: None }
}

/// Hot, and there.
fn survey(last: u64, xyz_mm: [f64; 3]) -> Survey {
    let hotend = Some(Heater { actual_c: 209.0, target_c: 210.0 });
    let bed = Some(Heater { actual_c: 60.0, target_c: 60.0 });
    Survey {
        last: Some(last),
        position: Some(Position { xyz_mm, e_mm: Some(1.0), step_mm: 0.01 }),
        temperatures: Temperatures { hotend, bed },
    }
}

fn decided(job: &mut Job<Cursor<Vec<u8>>>, known: &Known, survey: &Survey) -> Decision {
    decide(job, &profile(), known, survey).unwrap()
}

fn why(decision: Decision) -> Why {
    match decision {
        Decision::Recover(recovery) => recovery.why,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_printer_that_lives_is_gone_on_with_behind_its_last_line() {
    // Number 17 is line 16 of the job: six of the head, ten beads.
    let decision = decided(&mut job(50, ""), &known(18, 15, 10), &survey(17, [20.0, 10.0, 0.2]));
    let Decision::Exact(exact) = decision else { panic!("{decision:?}") };
    assert_eq!((exact.place, exact.modal.at_mm[0]), (Place::Job(16), Some(20.0)));
}

#[test]
fn a_line_that_the_journal_did_not_see_is_believed_only_where_the_host_died() {
    let mut late = known(18, 15, 10);
    let far = survey(31, [34.0, 10.0, 0.2]);
    assert_eq!(why(decided(&mut job(50, ""), &late, &far)), Why::OtherNumbers);
    late.is_behind = true;
    assert!(matches!(decided(&mut job(50, ""), &late, &far), Decision::Exact(_)));
}

#[test]
fn a_printer_that_counts_anew_or_is_elsewhere_or_cold_is_no_exact_case() {
    let mut job = job(50, "");
    let known = known(38, 35, 30);
    assert_eq!(why(decided(&mut job, &known, &survey(0, [0.0; 3]))), Why::Restarted);
    assert_eq!(why(decided(&mut job, &known, &survey(9, [12.0, 10.0, 0.2]))), Why::OtherNumbers);
    assert_eq!(why(decided(&mut job, &known, &survey(37, [41.0, 10.0, 0.2]))), Why::Elsewhere);
    let mut cold = survey(37, [40.0, 10.0, 0.2]);
    cold.temperatures.hotend = Some(Heater { actual_c: 60.0, target_c: 0.0 });
    assert_eq!(why(decided(&mut job, &known, &cold)), Why::HeatersOff);
    for (hotend_c, bed_c) in [(210.0, 0.0), (210.0, 40.0), (150.0, 60.0)] {
        let mut lower = survey(37, [40.0, 10.0, 0.2]);
        lower.temperatures.hotend = Some(Heater { actual_c: 209.0, target_c: hotend_c });
        lower.temperatures.bed = Some(Heater { actual_c: 60.0, target_c: bed_c });
        assert_eq!(why(decided(&mut job, &known, &lower)), Why::HeatersOff, "{hotend_c} {bed_c}");
        let soon = Known { away_s: Some(60.0), ..known.clone() };
        let Decision::Exact(exact) = decided(&mut job, &soon, &lower) else { panic!("{hotend_c} {bed_c}") };
        assert_eq!(exact.track.prelude, ["M140 S60", "M104 S210", "M190 S60", "M109 S210"]);
    }
    let mut tuned = survey(37, [40.0, 10.0, 0.2]);
    tuned.temperatures.hotend = Some(Heater { actual_c: 205.0, target_c: 205.0 });
    assert!(matches!(decided(&mut job, &known, &tuned), Decision::Exact(_)));
    let mute = Survey { position: None, ..survey(37, [0.0; 3]) };
    assert_eq!(why(decided(&mut job, &known, &mute)), Why::Elsewhere);
}

#[test]
fn a_nozzle_that_somebody_has_lifted_is_no_place_to_go_on_from() {
    let mut job = job(50, "");
    let refused = |decision| match decision {
        Decision::Refuse(refusal) => refusal.code(),
        other => panic!("{other:?}"),
    };
    let known = known(38, 35, 30);
    assert_eq!(
        refused(decided(&mut job, &known, &survey(37, [40.0, 10.0, 10.2]))),
        "printer.resume_height_unknown"
    );
    // After a reset the printer's own word is worth nothing.
    assert_eq!(why(decided(&mut job, &known, &survey(0, [0.0, 0.0, 10.2]))), Why::Restarted);
    // The last attempt was on its way back to the part.
    let prelude = vec!["M190 S60".into(), "G92 Z5.2".into(), "G1 Z0.2".into()];
    let track = Track { first_number: 1, prelude, n_before: 30, n_twice: 0, ..Track::default() };
    let progress =
        Progress { number: 2, n_sent: 30, n_acked: 30, n_certain: 30, n_begun: 30, ..Progress::default() };
    let away = Known { track: track.clone(), progress, is_behind: false, away_s: None };
    assert_eq!(refused(decided(&mut job, &away, &survey(0, [0.0; 3]))), "printer.resume_within_recovery");
    let back = Known {
        track,
        progress: Progress { n_sent: 40, n_acked: 38, n_certain: 34, n_begun: 40, ..progress },
        is_behind: false,
        away_s: None,
    };
    assert_eq!(why(decided(&mut job, &back, &survey(0, [0.0; 3]))), Why::Restarted);
}

#[test]
fn recovery_states_where_how_much_and_restores_the_modes() {
    let decision = decided(&mut job(50, ""), &known(38, 35, 30), &survey(0, [0.0; 3]));
    let Decision::Recover(recovery) = decision else { panic!("{decision:?}") };
    assert_eq!((recovery.n_done, recovery.n_twice, recovery.xyz_mm), (30, 8, [34.0, 10.0, 0.2]));
    assert!((recovery.twice_mm - 8.0).abs() < 1e-9);
    assert!(recovery.commands.contains(&"G92 Z0.2".to_owned()), "{:?}", recovery.commands);
    let end: Vec<_> = recovery.commands.iter().rev().take(4).rev().map(String::as_str).collect();
    assert_eq!(end, ["G92 E1.2", "G90", "M83", "G1 F3000"]);
    let text = recovery.to_string();
    assert!(
        text.contains("behind line 30 of 56") && text.contains("up to 8 lines (8.0 mm of bead)"),
        "{text}"
    );
}

#[test]
fn a_bed_that_has_cooled_is_told() {
    let mut survey = survey(0, [0.0; 3]);
    survey.temperatures.bed = Some(Heater { actual_c: 40.0, target_c: 0.0 });
    let Decision::Recover(recovery) = decided(&mut job(50, ""), &known(38, 35, 30), &survey) else {
        panic!()
    };
    assert!(recovery.to_string().contains("the bed has cooled by 20 K"));
    survey.temperatures.bed = Some(Heater { actual_c: 25.0, target_c: 0.0 });
    let Decision::Refuse(refusal) = decided(&mut job(50, ""), &known(38, 35, 30), &survey) else { panic!() };
    assert_eq!(refusal.code(), "printer.resume_part_cold");
    assert!(refusal.to_string().contains("the bed has cooled by 35 K"), "{refusal}");
}

/// A job that begins with more than heat.
fn job_with(head: &str) -> Job<Cursor<Vec<u8>>> {
    let beads: String = (1..=50).map(|i| format!("G1 X{} E0.05\n", 10 + i)).collect();
    Job::from_text(format!("{head}{HEAD}{beads}"), "j", &profile().firmware).unwrap()
}

#[test]
fn what_the_job_had_set_is_set_again_and_told() {
    let mut job = job_with("M201 X900 Y900\nM204 P800\nM205 J0.02\nM220 S95\nM900 K0.05\n");
    let Decision::Recover(recovery) = decided(&mut job, &known(43, 40, 35), &survey(0, [0.0; 3])) else {
        panic!()
    };
    for line in ["M201 X900 Y900", "M204 P800", "M205 J0.02", "M220 S95", "M900 K0.05"] {
        assert!(recovery.commands.contains(&line.to_owned()), "{line}: {:?}", recovery.commands);
    }
    let text = recovery.to_string();
    assert!(text.contains("what the job had set is set again: M201, M204, M205, M220, M900"), "{text}");
}

#[test]
fn what_cannot_be_brought_about_again_is_refused() {
    for (head, words) in [("G20\n", "inches"), ("G28\nG29\n", "bed's mesh"), ("T1\n", "several tools")] {
        let n = head.lines().count() as u64;
        let known = known(38 + n, 35 + n, 30 + n);
        let Decision::Refuse(refusal) = decided(&mut job_with(head), &known, &survey(0, [0.0; 3])) else {
            panic!("{head}")
        };
        assert_eq!(refusal.code(), "printer.resume_beyond");
        assert!(refusal.to_string().contains(words), "{refusal}");
    }
}

#[test]
fn filament_that_was_drawn_back_is_drawn_back_again() {
    let mut job = job(30, "G1 E-0.8 F2100\nG0 X50 F9000\nG0 X60\nG1 E0.8\nG1 X70 E1\n");
    let Decision::Recover(recovery) = decided(&mut job, &known(39, 39, 37), &survey(0, [0.0; 3])) else {
        panic!()
    };
    let at = recovery.commands.iter().position(|line| line == "G1 E-0.8 F1800").unwrap();
    assert!(at > recovery.commands.iter().position(|line| line.starts_with("G28")).unwrap());
    assert!(recovery.commands[at..].contains(&"G92 E0.7".to_owned()), "{:?}", recovery.commands);
}

#[test]
fn a_printer_that_was_switched_off_a_moment_ago_is_warmed_up_and_goes_on_exactly() {
    let mut known = known(38, 35, 30);
    let mut cold = survey(37, [40.0, 10.0, 0.2]);
    cold.temperatures.hotend = Some(Heater { actual_c: 150.0, target_c: 0.0 });
    assert_eq!(why(decided(&mut job(50, ""), &known, &cold)), Why::HeatersOff, "nobody knows since when");
    known.away_s = Some(600.0);
    let Decision::Exact(exact) = decided(&mut job(50, ""), &known, &cold) else { panic!() };
    assert_eq!((exact.place, exact.n_done()), (Place::Prelude(0), 36));
    let Track { first_number, prelude, n_before, .. } = &exact.track;
    assert_eq!((*first_number, *n_before), (38, 36));
    assert_eq!(*prelude, ["M140 S60", "M104 S210", "M190 S60", "M109 S210"]);
    // The motors have let go meanwhile.
    known.away_s = Some(4000.0);
    assert_eq!(why(decided(&mut job(50, ""), &known, &cold)), Why::HeatersOff);
    // The part may have let go of the bed.
    known.away_s = Some(600.0);
    cold.temperatures.bed = Some(Heater { actual_c: 40.0, target_c: 0.0 });
    assert_eq!(why(decided(&mut job(50, ""), &known, &cold)), Why::HeatersOff);
}

#[test]
fn an_unknown_height_is_refused_unless_the_profile_homes_z() {
    let mut job = job(20, "G1 Z0.4\nG1 X10 E1\nG1 X20 E1\n");
    let known = known(28, 26, 24);
    let Decision::Refuse(refusal) = decided(&mut job, &known, &survey(0, [0.0; 3])) else { panic!() };
    assert_eq!(refusal.code(), "printer.resume_height_unknown");
    assert!(refusal.to_string().contains("Z may be anywhere from 0.20 mm to 0.40 mm"), "{refusal}");
    let mut probing = profile();
    probing.scripts.recovery.push("G28".to_owned());
    let decision = decide(&mut job, &probing, &known, &survey(0, [0.0; 3])).unwrap();
    assert!(matches!(decision, Decision::Recover(_)));
}

#[test]
fn nothing_printed_and_no_script_are_refused() {
    let mut early = job(20, "");
    let Decision::Refuse(refusal) = decided(&mut early, &known(6, 5, 4), &survey(0, [0.0; 3])) else {
        panic!()
    };
    assert_eq!(refusal, Refusal::NothingPrinted { why: Why::Restarted });
    let mut bare = profile();
    bare.scripts.recovery.clear();
    let decision = decide(&mut early, &bare, &known(20, 20, 20), &survey(0, [0.0; 3])).unwrap();
    assert_eq!(decision, Decision::Refuse(Refusal::NoScript { why: Why::Restarted }));
}

#[test]
fn the_journal_s_last_second_counts_where_the_host_died_too() {
    let mut known = known(38, 35, 30);
    known.is_behind = true;
    let Decision::Recover(recovery) = decided(&mut job(500, ""), &known, &survey(0, [0.0; 3])) else {
        panic!()
    };
    // 1 mm at 50 mm/s, turned up by half: 75 lines a second, for 1.25 s.
    assert!((95..=106).contains(&recovery.n_twice), "{}", recovery.n_twice);
}

/// The power failed while the host had not written down for a while: where the height certainly is the same, it goes on.
#[test]
fn a_lift_that_was_not_let_was_not_begun() {
    let tail = "G0 Z0.4\nG0 X0 F9000\nG0 Z0.2\nG1 X90 E0.1\n";
    let mut known = known(40, 36, 30);
    known.is_behind = true;
    let off = Survey { last: Some(0), position: None, ..survey(0, [0.0; 3]) };
    let n_lift = 6 + 40 + 1;
    for (z_allowed_to, is_known) in [(Some(n_lift - 1), true), (Some(n_lift), false), (None, false)] {
        known.progress.z_allowed_to = z_allowed_to;
        let decision = decided(&mut job(40, tail), &known, &off);
        assert_eq!(matches!(decision, Decision::Recover(_)), is_known, "{z_allowed_to:?} {decision:?}");
    }
}

fn by_place(text: &str, n_acked: u64, n_sent: u64, xyz_mm: [f64; 3], e_mm: f64) -> Decision {
    let mut klipper = crate::profile::builtin("klipper").unwrap();
    klipper.scripts.recovery = profile().scripts.recovery;
    let mut job = Job::from_text(text, "j", &klipper.firmware).unwrap();
    let position = Some(Position { xyz_mm, e_mm: Some(e_mm), step_mm: 0.001 });
    let survey = Survey { last: None, position, ..survey(0, xyz_mm) };
    decide(&mut job, &klipper, &known(n_sent, n_acked, n_acked), &survey).unwrap()
}

#[test]
fn without_numbers_the_place_tells_the_line() {
    let text = format!("{HEAD}G1 X11 E0.05\nG1 X12 E0.05\nM106 S9\nG1 X13 E0.05\n");
    let decision = by_place(&text, 6, 10, [12.0, 10.0, 0.2], 0.1);
    let Decision::Exact(exact) = decision else { panic!("{decision:?}") };
    assert_eq!((exact.place, exact.track.n_before), (Place::Job(8), 8), "the fan is set once more");
    assert!(matches!(by_place(&text, 8, 10, [12.5, 10.0, 0.2], 0.1), Decision::Recover(_)));
}

#[test]
fn what_may_not_be_done_twice_at_one_place_makes_it_two() {
    for line in ["PAUSE_AND_PURGE", "M600"] {
        let text = format!("{HEAD}G1 X11 E0.05\nG1 X12 E0.05\n{line}\nG1 X13 E0.05\n");
        let decision = by_place(&text, 6, 10, [12.0, 10.0, 0.2], 0.1);
        assert_eq!(decision, Decision::Refuse(Refusal::Ambiguous { n_places: 2, first: 8 }), "{line}");
    }
}

#[test]
fn without_numbers_two_like_places_are_refused() {
    let text = format!("{HEAD}G1 X11\nG1 X12\nG1 X11\nG1 X13\n");
    let decision = by_place(&text, 6, 10, [11.0, 10.0, 0.2], 0.0);
    assert_eq!(decision, Decision::Refuse(Refusal::Ambiguous { n_places: 2, first: 7 }));
}

proptest::proptest! {
    #[test]
    fn whatever_a_printer_says_something_is_decided(
        last in proptest::option::of(0..200_u64),
        x in -10.0..80.0_f64,
        sent in 0..60_u64,
        acked in 0..60_u64,
    ) {
        let known = known(sent.max(acked), acked, acked.saturating_sub(16));
        let survey = Survey { last, ..survey(0, [x, 10.0, 0.2]) };
        decided(&mut job(50, ""), &known, &survey);
    }
}
