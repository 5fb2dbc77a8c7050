//! How often a job is printed, however often that is changed on the way.

use super::*;

fn of_copies(copies: u16, sign_off: bool) -> Job {
    queued(&Ticket { wishes: Wishes { copies, sign_off, ..Wishes::default() }, ..ticket(1) })
}

/// A copy lies on the bed.
fn printed(job: Job) -> Scene {
    held_by(&laid(job), Change::Printed { used_mm3: None }, 30).unwrap().scene
}

/// A copy is printed and off the bed.
fn done(job: Job) -> Job {
    cleared(&printed(job), 40).unwrap().job.unwrap()
}

fn lowered(scene: &Scene, copies: u16) -> Result<Outcome, Refusal> {
    asked(scene, Change::Edit(Edit::Copies(copies)), 50)
}

#[test]
fn a_waiting_job_ends_where_no_more_copies_are_wanted_than_are_printed() {
    for (sign_off, expected) in [(false, State::Finished), (true, State::AwaitingSignOff)] {
        let waiting = scene(done(of_copies(3, sign_off)));
        let held = asked(&waiting, Change::Hold, 45).unwrap().scene;
        for before in [waiting, held] {
            let after = lowered(&before, 1).unwrap();
            let job = after.scene.job;
            assert_eq!((job.state, job.n_printed, job.n_left()), (expected, 1, 0));
            assert_eq!(after.facts.len(), 2);
        }
    }
}

#[test]
fn a_waiting_job_of_which_copies_are_left_goes_on_waiting() {
    let after = lowered(&scene(done(of_copies(3, false))), 2).unwrap().scene.job;
    assert_eq!((after.state, after.n_left()), (State::Queued, 1));
    assert_eq!(done(after).state, State::Finished);
}

#[test]
fn copies_are_never_fewer_than_begun() {
    let waiting = scene(done(done(of_copies(4, false))));
    let in_print = laid(waiting.job.clone());
    let on_bed = printed(waiting.job.clone());
    for (before, least) in [(scene(of_copies(4, false)), 1), (waiting, 2), (in_print, 3), (on_bed, 3)] {
        let found = least - 1;
        assert_eq!(lowered(&before, found).unwrap_err(), Refusal::Copies { found, least });
        assert_eq!(lowered(&before, least).unwrap().scene.job.wishes.copies, least);
    }
}

#[test]
fn the_copy_in_print_is_the_last_where_no_more_are_wanted() {
    let in_print = lowered(&laid(done(of_copies(3, false))), 2).unwrap().scene;
    assert_eq!(in_print.job.state, State::Printing);
    let on_bed = held_by(&in_print, Change::Printed { used_mm3: None }, 60).unwrap().scene;
    let after = cleared(&on_bed, 70).unwrap().job.unwrap();
    assert_eq!((after.state, after.n_printed), (State::Finished, 2));
}

#[test]
fn copies_may_be_added_until_the_bed_is_clear_of_the_last_one() {
    let on_bed = printed(of_copies(1, true));
    let more = lowered(&on_bed, 2).unwrap().scene;
    let again = cleared(&more, 60).unwrap().job.unwrap();
    assert_eq!((again.state, again.n_left()), (State::Queued, 1));
    for job in [done(of_copies(1, true)), done(of_copies(1, false))] {
        let refused = Refusal::NotInState { state: job.state, change: Kind::Edit };
        assert_eq!(lowered(&scene(job), 2).unwrap_err(), refused);
    }
}

#[test]
fn a_copy_that_failed_is_printed_again_and_none_that_is_done() {
    let failed =
        held_by(&laid(done(of_copies(2, false))), Change::Fail { used_mm3: None }, 60).unwrap().scene;
    let again = asked(&failed, Change::Retry, 70).unwrap().scene.job;
    assert_eq!((again.n_printed, again.n_left()), (1, 1));
    assert_eq!(lowered(&scene(again.clone()), 1).unwrap().scene.job.state, State::Finished);
    let finished = done(again);
    assert_eq!((finished.state, finished.n_printed), (State::Finished, 2));
}
