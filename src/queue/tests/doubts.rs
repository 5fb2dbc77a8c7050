//! What is not known of a bed any more, and what is not loaded any more.

use super::*;

/// Whatever a job that has laid nothing does to a bed which is doubted meanwhile.
#[test]
fn a_doubt_stays_when_the_job_that_laid_nothing_leaves_the_bed() {
    let started = started(queued(&ticket(1)));
    let doubted = said(started.printer.as_ref().unwrap(), &started.job, &Said::BedInDoubt).unwrap();
    let doubted = Scene { printer: Some(doubted.printer), ..started };
    let adopted = act::adopt(&doubted, &name("left"), 9, at(20)).unwrap().scene;
    let loaded = Said::Loaded(loaded());
    let reloaded = said(doubted.printer.as_ref().unwrap(), &doubted.job, &loaded).unwrap().printer;
    let reloaded = Scene { printer: Some(reloaded), ..doubted.clone() };
    let fail = Change::Fail { used_mm3: None };
    let cancel = Change::Cancel { used_mm3: None };
    let given_back = Change::GiveBack { lost: false };
    let after = [
        act::lost(&doubted, at(1000)).unwrap().unwrap(),
        asked(&doubted, cancel.clone(), 1000).unwrap(),
        held_by(&doubted, fail, 20).unwrap(),
        held_by(&doubted, cancel, 20).unwrap(),
        held_by(&adopted, given_back.clone(), 21).unwrap(),
        held_by(&reloaded, given_back, 22).unwrap(),
    ];
    for outcome in after {
        let printer = outcome.scene.printer.unwrap();
        assert_eq!(printer.bed, Bed::Unknown, "{:?}", outcome.facts);
        let cleared = said(&printer, &outcome.scene.job, &CLEAR).unwrap().printer;
        assert_eq!(cleared.bed, Bed::Clear);
    }
}

#[test]
fn nothing_is_laid_onto_a_bed_that_was_doubted_since_it_was_taken() {
    let started = started(queued(&ticket(1)));
    let doubted = said(started.printer.as_ref().unwrap(), &started.job, &Said::BedInDoubt).unwrap();
    let doubted = Scene { printer: Some(doubted.printer), ..started };
    let refused = held_by(&doubted, Change::Lay, 20).unwrap_err();
    assert_eq!(refused, Refusal::BedNotClear { printer: name("left") });
}

#[test]
fn a_bed_that_was_doubted_during_a_print_is_clear_by_the_word_for_both() {
    let in_print = laid(queued(&ticket(1)));
    let doubted = said(in_print.printer.as_ref().unwrap(), &in_print.job, &Said::BedInDoubt).unwrap();
    let doubted = Scene { printer: Some(doubted.printer), ..in_print };
    let printed = held_by(&doubted, Change::Printed { used_mm3: None }, 30).unwrap().scene;
    let after = cleared(&printed, 40).unwrap();
    assert_eq!((after.printer.bed, after.job.unwrap().state), (Bed::Clear, State::Finished));
    let next = Scene { printer: Some(after.printer), ..scene(queued(&ticket(2))) };
    let next = act::claim(&next, &Claimant::Printer(name("left")), 9, at(50)).unwrap().scene;
    assert_eq!(held_by(&next, Change::Lay, 60).unwrap().scene.job.state, State::Printing);
}

#[test]
fn a_word_about_one_job_does_not_clear_the_bed_of_the_next() {
    let word = Said::BedClearOf(id(1), Evidence::Word);
    let printed = held_by(&laid(queued(&ticket(1))), Change::Printed { used_mm3: None }, 30).unwrap().scene;
    let first = said(printed.printer.as_ref().unwrap(), &printed.job, &word).unwrap();
    assert_eq!((first.printer.bed, first.job.unwrap().state), (Bed::Clear, State::Finished));
    let again = said(&first.printer, &printed.job, &word).unwrap().printer;
    assert_eq!(again.bed, Bed::Clear);
    let next = Scene { printer: Some(again), ..scene(queued(&ticket(2))) };
    let next = act::claim(&next, &Claimant::Printer(name("left")), 9, at(50)).unwrap().scene;
    let failed =
        held_by(&held_by(&next, Change::Lay, 60).unwrap().scene, Change::Fail { used_mm3: None }, 70);
    let failed = failed.unwrap().scene;
    let refused = said(failed.printer.as_ref().unwrap(), &failed.job, &word).unwrap_err();
    assert_eq!(refused, Refusal::BedInUse { printer: name("left"), job: id(2) });
}

#[test]
fn a_job_that_used_filament_leaves_no_clear_bed_whatever_was_announced() {
    let started = started(queued(&ticket(1)));
    for change in [Change::Fail { used_mm3: Some(3) }, Change::Cancel { used_mm3: Some(3) }] {
        let after = held_by(&started, change, 30).unwrap().scene.printer.unwrap();
        assert_eq!((after.bed, after.loaded.unwrap().left_mm3), (Bed::Taken(id(1)), Some(99_997)));
    }
}

#[test]
fn nothing_is_laid_with_what_was_loaded_in_place_of_what_fitted() {
    let mut needs_abs = ticket(1);
    needs_abs.made.as_mut().unwrap().needs.material = Material::try_new("ABS").ok();
    let started = started(queued(&needs_abs));
    let pla = Loaded { material: Material::try_new("PLA").unwrap(), ..loaded() };
    let other = said(started.printer.as_ref().unwrap(), &started.job, &Said::Loaded(pla)).unwrap();
    let other = Scene { printer: Some(other.printer), ..started };
    let refused = held_by(&other, Change::Lay, 20).unwrap_err();
    assert!(matches!(refused, Refusal::Misfit(Misfit::Material { .. })), "{refused}");
}
