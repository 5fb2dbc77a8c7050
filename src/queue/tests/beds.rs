//! A job whose remains lie on one bed while it goes on with another.

use super::schedule::{self, Lane, WhyNot};
use super::*;

/// Its remains lie on the left bed: the print failed there, and an operator let it be tried again.
fn tried_again() -> (Job, Printer) {
    let two = Ticket { wishes: Wishes { copies: 2, ..Wishes::default() }, ..ticket(1) };
    let failed = held_by(&laid(queued(&two)), Change::Fail { used_mm3: None }, 30).unwrap().scene;
    let again = asked(&failed, Change::Retry, 40).unwrap().scene;
    (again.job, failed.printer.unwrap())
}

/// And it is in print on the right one.
fn elsewhere() -> (Scene, Printer) {
    let (job, left) = tried_again();
    let right = Printer { name: name("right"), ..printer(Bed::Clear) };
    let ready = Scene { printer: Some(right), ..scene(job) };
    let started = act::claim(&ready, &Claimant::Printer(name("right")), 9, at(50)).unwrap().scene;
    (held_by(&started, Change::Lay, 60).unwrap().scene, left)
}

#[test]
fn remains_are_cleared_while_the_job_is_in_print_elsewhere() {
    let (in_print, left) = elsewhere();
    let after = said(&left, &in_print.job, &CLEAR).unwrap();
    assert_eq!((after.printer.bed, after.job), (Bed::Clear, Some(in_print.job)));
}

#[test]
fn a_copy_waits_for_the_bed_it_lies_on_and_for_no_other() {
    let (in_print, left) = elsewhere();
    let on_right = held_by(&in_print, Change::Printed { used_mm3: None }, 70).unwrap().scene;
    let after = said(&left, &on_right.job, &CLEAR).unwrap();
    assert_eq!((after.printer.bed, after.job.as_ref()), (Bed::Clear, Some(&on_right.job)));
    let after = said(&on_right.printer.unwrap(), &on_right.job, &CLEAR).unwrap();
    let job = after.job.unwrap();
    assert_eq!((job.state, job.n_printed), (State::Queued, 1));
}

#[test]
fn remains_on_a_bed_are_not_a_print() {
    let (in_print, left) = elsewhere();
    let on = |printer: &Printer| schedule::next(printer, std::slice::from_ref(&in_print.job), at(80));
    assert!(matches!(on(&left).unwrap_err(), WhyNot::BedTaken { .. }));
    assert!(matches!(on(in_print.printer.as_ref().unwrap()).unwrap_err(), WhyNot::Printing { .. }));
}

#[test]
fn a_plan_knows_where_a_job_is_in_print() {
    let (in_print, left) = elsewhere();
    let lane = |printer, ends| Lane { printer, ends, clearing_s: 600 };
    let lanes = [lane(left, None), lane(in_print.printer.unwrap(), Some(at(1000)))];
    let slots = |lanes: &[Lane]| -> Vec<_> {
        let plan = schedule::plan(lanes, std::slice::from_ref(&in_print.job), at(80));
        plan.slots.into_iter().map(|s| (s.printer.to_string(), s.copy, s.starts, s.ends)).collect()
    };
    let first = ("right".to_owned(), 1, at(80), at(1000));
    assert_eq!(slots(&lanes), [first, ("left".to_owned(), 2, at(1600), at(5200))]);
    // When it ends on a printer that the plan does not know, nobody knows.
    assert_eq!(slots(&lanes[..1]), []);
}

#[test]
fn a_plan_lets_a_job_be_tried_again_at_once_on_another_printer() {
    let (job, left) = tried_again();
    let right = Printer { name: name("right"), ..printer(Bed::Clear) };
    let lanes = [left, right].map(|printer| Lane { printer, ends: Some(at(5000)), clearing_s: 600 });
    let plan = schedule::plan(&lanes, std::slice::from_ref(&job), at(80));
    assert_eq!((plan.slots[0].printer.as_str(), plan.slots[0].starts), ("right", at(80)));
}
