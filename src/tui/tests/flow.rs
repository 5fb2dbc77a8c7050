//! What follows from keys, clicks and news.

use super::*;
use crate::http::wire::{Anew, BedClear, Move, Order, Turn};
use crate::tui::command::Command;
use crate::tui::message::{Answer, Request, Target};
use crate::tui::state::{Link, Listing, Overlay, Screen};
use ratatui::layout::Position;

fn desk() -> Desk {
    let mut desk = Desk::printing(100, 30, Theme::Dark);
    desk.asked();
    desk
}

/// The only thing that was asked.
fn request(desk: &mut Desk) -> Request {
    match desk.asked().as_slice() {
        [Effect::Ask(request)] => request.clone(),
        other => panic!("{other:?}"),
    }
}

fn change(n: u8, turn: Turn, saw: JobState) -> (JobId, Anew) {
    (id(n), Anew { turn, saw: Some(saw), name: None, why: Reason::default() })
}

#[test]
fn keys_of_the_queue_ask_for_what_they_say() {
    let cases = [
        ("2jh", change(2, Turn::Hold, JobState::Queued), Some(Turn::Release)),
        ("2jjjr", change(4, Turn::Release, JobState::Held), Some(Turn::Hold)),
        ("2Gu", change(5, Turn::Submit, JobState::Draft), None),
        (
            "2jjjK",
            change(4, Turn::Move(Move::Before(id(3))), JobState::Held),
            Some(Turn::Move(Move::Behind(id(3)))),
        ),
        (
            "2jjJ",
            change(3, Turn::Move(Move::Behind(id(4))), JobState::Preparing),
            Some(Turn::Move(Move::Before(id(4)))),
        ),
        ("2jjjL", change(4, Turn::Move(Move::Last), JobState::Held), Some(Turn::Move(Move::Before(id(5))))),
        ("2jjo0\r", change(3, Turn::Copies(10), JobState::Preparing), Some(Turn::Copies(1))),
        ("1p", change(1, Turn::Pause, JobState::Printing), None),
    ];
    for (keys, (job, anew), back) in cases {
        let mut desk = desk();
        desk.press(keys);
        assert_eq!(request(&mut desk), Request::Change(job, anew, back), "{keys}");
    }
}

#[test]
fn what_cannot_be_done_is_not_asked_and_said() {
    for (keys, said) in [
        ("2jK", "earlier: it is there already"),
        ("2r", "release: the job is printing"),
        ("c", "go on: nothing is paused"),
        ("b", "bed is clear: no bed waits for it"),
        ("2n", "next match: nothing was looked for"),
        ("z", ""),
        ("]", "next printer: there is no other one"),
    ] {
        let mut desk = desk();
        desk.press(keys);
        assert_eq!(desk.asked(), [], "{keys}");
        assert!(desk.text().contains(said), "{keys}\n{}", desk.text());
    }
}

#[test]
fn the_last_change_is_taken_back_once() {
    let mut desk = desk();
    desk.press("2jh");
    let asked = request(&mut desk);
    desk.hear(Message::Answered(asked, Ok(Answer::Done)));
    desk.press("z");
    let anew = Anew { turn: Turn::Release, saw: None, name: None, why: Reason::default() };
    assert_eq!(request(&mut desk), Request::Change(id(2), anew, None));
    desk.press("z");
    assert_eq!(desk.asked(), []);
}

fn awaiting_bed() -> Desk {
    let mut desk = desk();
    let live = Live { activity: Activity::Idle, done: None, ..printing() };
    desk.hear(Message::News(News::Changed(vec![JobView {
        holder: Some(name("left")),
        revision: 4,
        ..job(1, JobState::AwaitingBedClear)
    }])));
    desk.hear(Message::News(News::Printers(vec![printer(BedView::Taken(id(1)), live)])));
    desk.asked();
    desk
}

#[test]
fn a_bed_is_not_said_to_be_clear_by_accident() {
    // Every key once, in any order, and some of them often: nothing is said.
    let keys: String = (' '..='~').filter(|c| *c != 'q').collect();
    for keys in
        [keys.clone(), keys.chars().rev().collect(), "b\r\r\r".into(), "byyy\r\r\r".into(), "bb\r\r".into()]
    {
        let mut desk = awaiting_bed();
        desk.press(&keys);
        desk.press("\r\r");
        let clears = |effect: &Effect| matches!(effect, Effect::Ask(Request::ClearBed(..)));
        assert!(!desk.asked().iter().any(clears), "{keys}");
    }
}

#[test]
fn the_word_that_a_bed_is_clear_names_the_job_that_was_taken_off() {
    let mut desk = awaiting_bed();
    desk.press("bclear\rscraped\r");
    let why = Reason::try_new("scraped").unwrap();
    let word = BedClear { on_bed: Some(id(1)), name: None, why };
    assert_eq!(request(&mut desk), Request::ClearBed(name("left"), word));
}

#[test]
fn a_question_whose_answer_came_from_somebody_else_goes_away() {
    let mut desk = awaiting_bed();
    desk.press("bcle");
    let live = Live { activity: Activity::Idle, ..printing() };
    desk.hear(Message::News(News::Printers(vec![printer(BedView::Clear, live)])));
    assert_eq!(desk.state.overlay, None);
    assert!(desk.text().contains("somebody else"));
    desk.press("ar\r\r");
    assert_eq!(desk.asked(), []);
}

#[test]
fn a_fault_shows_while_a_question_is_open() {
    let mut desk = desk();
    desk.press("2jx");
    let says = Some("the nozzle is 40 °C too hot".to_owned());
    desk.hear(Message::News(News::Lives(vec![Live { activity: Activity::Faulted, says, ..printing() }])));
    let text = desk.text();
    assert!(text.contains("too hot") && text.contains("Call job"), "{text}");
    desk.press("not wanted\r");
    let (job, mut anew) = change(2, Turn::Cancel, JobState::Queued);
    anew.why = Reason::try_new("not wanted").unwrap();
    assert_eq!(request(&mut desk), Request::Change(job, anew, None));
}

#[test]
fn a_print_is_given_up_only_by_the_word() {
    let mut desk = desk();
    desk.press("xxx\r\r\r");
    assert_eq!(desk.asked(), []);
    desk.press("\u{1b}xcancel\r\r");
    let (job, anew) = change(1, Turn::Cancel, JobState::Printing);
    assert_eq!(request(&mut desk), Request::Change(job, anew, None));
}

#[test]
fn a_sign_off_needs_decision_name_and_reason() {
    let mut desk = desk();
    desk.hear(Message::News(News::Changed(vec![JobView {
        n_printed: 2,
        ..job(1, JobState::AwaitingSignOff)
    }])));
    desk.asked();
    desk.press("sreject\r\rp95 too large\r");
    assert_eq!(desk.asked(), [], "the name is missing");
    assert!(desk.text().contains("your name is missing"));
    desk.press("Ada\r\r");
    let (name, why) = (Some(name("Ada")), Reason::try_new("p95 too large").unwrap());
    let anew = Anew { turn: Turn::Reject, saw: Some(JobState::AwaitingSignOff), name, why };
    assert_eq!(request(&mut desk), Request::Change(id(1), anew, None));
}

#[test]
fn without_a_connection_nothing_is_asked_and_what_was_seen_stays() {
    let mut desk = desk();
    desk.hear(Message::Link(LinkNews::NoServer));
    assert!(matches!(desk.state.link, Link::Lost { .. }));
    for keys in ["p", "2jh", "2jx", "2jK"] {
        desk.press(keys);
    }
    assert_eq!(desk.asked(), []);
    let text = desk.text();
    assert!(text.contains("no connection since 14:30") && text.contains("printing"), "{text}");
}

#[test]
fn a_server_is_started_once_and_what_hinders_it_is_said() {
    let mut desk = Desk::new(80, 24, Theme::Dark);
    desk.press("S");
    assert_eq!(desk.asked(), [], "it is not known yet whether one runs");
    desk.hear(Message::Link(LinkNews::NoServer));
    desk.press("SS");
    assert_eq!(request(&mut desk), Request::Start);
    desk.hear(Message::Link(LinkNews::NoServer));
    desk.hear(Message::Answered(Request::Start, Err("the server ended at once".to_owned())));
    assert!(desk.text().contains("ended at once"));
    desk.press("S");
    assert_eq!(request(&mut desk), Request::Start);
}

#[test]
fn on_a_screen_that_is_not_seen_nothing_is_done() {
    let mut desk = desk();
    desk.hear(Message::Resize(Size { width: 20, height: 5 }));
    desk.press("p2jh:x");
    assert_eq!((desk.asked(), &desk.state.overlay), (vec![], &None));
    desk.press("q");
    assert_eq!(desk.asked(), [Effect::Quit]);
}

#[test]
fn every_size_is_drawn() {
    for keys in ["", "2\r", "3", "?", ":", "x", "2/", "!"] {
        for width in [1, 19, 20, 79, 80, 81, 119, 120, 149, 150, 200, 300] {
            for height in [1, 2, 5, 23, 24, 25, 40, 100] {
                let mut desk = Desk::new(width, height, Theme::Dark);
                desk.up(vec![printer(BedView::Taken(id(1)), printing())], vec![job(1, JobState::Printing)]);
                desk.press(keys);
                desk.draw();
            }
        }
    }
}

#[test]
fn of_ten_thousand_jobs_what_is_seen_is_drawn_and_all_are_reached() {
    let mut desk = Desk::printing(200, 60, Theme::Dark);
    let jobs: Vec<_> = (0..10_000u32)
        .map(|n| {
            let bytes = n.to_be_bytes();
            let chance = [0, 0, 0, 0, 0, 0, bytes[0], bytes[1], bytes[2], bytes[3]];
            JobView { id: JobId::at(now(), chance), ..job(2, JobState::Queued) }
        })
        .collect();
    desk.hear(Message::News(News::Jobs(Which::Live, jobs, false)));
    desk.press("2G");
    assert_eq!(desk.state.row(), 9999);
    let text = desk.text();
    assert_eq!(
        text.matches("queued").count(),
        10_000 % view::rows_of_list(&desk.state) + 1,
        "and the details"
    );
    desk.press("gjjj/0000270f\r");
    assert_eq!(desk.state.row(), 9999);
    desk.hear(Message::Scroll(-3));
    assert_eq!(desk.state.row(), 9996);
}

#[test]
fn a_search_goes_round_and_says_where_there_is_nothing() {
    let mut desk = desk();
    desk.press("2/held\r");
    assert_eq!(desk.state.chosen().map(|job| job.id), Some(id(4)));
    desk.press("/case\rn");
    assert_eq!(desk.state.chosen().map(|job| job.id), Some(id(3)), "the only one");
    desk.press("/unheard of\r");
    assert!(desk.text().contains("no job holds"));
    desk.press("/pla\rN");
    assert_eq!(desk.state.chosen().map(|job| job.id), Some(id(2)));
}

#[test]
fn the_chosen_job_stays_chosen_while_others_come_and_go() {
    let mut desk = desk();
    desk.press("2jj");
    let before: Vec<_> = desk.state.live.jobs.clone();
    let mut jobs = vec![job(7, JobState::Queued)];
    jobs.extend(before.into_iter().skip(1));
    desk.hear(Message::News(News::Jobs(Which::Live, jobs, false)));
    assert_eq!(desk.state.chosen().map(|job| job.id), Some(id(3)));
    desk.hear(Message::News(News::Changed(vec![job(3, JobState::Cancelled)])));
    assert_eq!(desk.state.chosen().map(|job| job.id), Some(id(4)), "the one in its place");
    assert_eq!(desk.state.over.jobs[0].id, id(3));
}

#[test]
fn an_older_news_of_a_job_changes_nothing() {
    let mut desk = desk();
    desk.hear(Message::News(News::Changed(vec![JobView { revision: 1, ..job(2, JobState::Held) }])));
    assert_eq!(desk.state.job(id(2)).map(|job| job.state), Some(JobState::Queued));
}

#[test]
fn the_mouse_does_what_keys_do() {
    let mut desk = desk();
    let find = |desk: &Desk, text: &str| {
        let found = lines(&desk.draw().0).iter().enumerate().find_map(|(y, line)| {
            let at = line.find(text)?;
            Some((line[..at].chars().count(), y))
        });
        let (x, y) = found.unwrap();
        Position { x: u16::try_from(x).unwrap(), y: u16::try_from(y).unwrap() }
    };
    let click = |desk: &mut Desk, text: &str| {
        let at = find(desk, text);
        let target = desk.draw().1.at(at).unwrap();
        desk.hear(Message::Click(target));
    };
    click(&mut desk, "2 queue");
    assert_eq!(desk.state.screen, Screen::Queue);
    click(&mut desk, "held");
    assert_eq!(desk.state.chosen().map(|job| job.id), Some(id(4)));
    click(&mut desk, "r release");
    assert_eq!(desk.draw().1.at(Position { x: 0, y: 29 }), None);
    let (job, anew) = change(4, Turn::Release, JobState::Held);
    assert_eq!(request(&mut desk), Request::Change(job, anew, Some(Turn::Hold)));
    desk.press(":over");
    click(&mut desk, "over or not");
    assert_eq!(desk.state.browsing.listing, Listing::Over);
    assert_eq!(desk.draw().1.at(find(&desk, "2 queue")), Some(Target::Command(Command::Queue)));
}

#[test]
fn behind_a_question_nothing_is_clicked() {
    let mut desk = desk();
    desk.press("2jx");
    let (_, hits) = desk.draw();
    for x in 0..100 {
        for y in 0..30 {
            assert_eq!(hits.at(Position { x, y }), None);
        }
    }
    assert!(matches!(desk.state.overlay, Some(Overlay::Form(_))));
}

#[test]
fn a_notice_goes_by_itself() {
    let mut desk = desk();
    desk.press("t");
    assert!(desk.text().contains("theme: light"));
    desk.hear(Message::Tick(later(9)));
    assert!(!desk.text().contains("theme: light"));
}

fn order(desk: &mut Desk) -> (Name, Order) {
    match request(desk) {
        Request::Order(printer, ordered) => (printer, ordered.order),
        other => panic!("{other:?}"),
    }
}

#[test]
fn one_key_stops_the_printer_from_everywhere() {
    for keys in ["!", "2!", "3!", "?!", ":!", "2/a!", "x!", "2jx!", "2jo!"] {
        let mut desk = desk();
        desk.press(keys);
        assert_eq!(order(&mut desk), (name("left"), Order::EmergencyStop), "{keys}");
    }
    let mut desk = desk();
    desk.hear(Message::Resize(Size { width: 20, height: 5 }));
    desk.press("!");
    assert_eq!(order(&mut desk), (name("left"), Order::EmergencyStop));
    assert!(desk.text().contains("EMERGENCY STOP"), "{}", desk.text());
}

#[test]
fn an_emergency_stop_is_done_once_the_printer_says_so() {
    let mut desk = desk();
    desk.press("!");
    let asked = request(&mut desk);
    assert!(desk.text().contains("no word from the printer yet"));
    desk.hear(Message::Answered(asked, Ok(Answer::Done)));
    let live = |activity, says: Option<&str>| {
        vec![Live { activity, says: says.map(str::to_owned), done: None, ..printing() }]
    };
    desk.hear(Message::News(News::Lives(live(Activity::Cancelling, None))));
    assert!(desk.text().contains("no word from the printer yet"), "{}", desk.text());
    desk.hear(Message::News(News::Lives(live(Activity::Paused, Some("the printer has halted")))));
    let stopped = "left has stopped (emergency stop, 14:30): the printer has halted";
    assert!(desk.text().contains(stopped), "{}", desk.text());
    desk.press("\u{1b}");
    assert!(!desk.text().contains(stopped));
}

#[test]
fn an_emergency_stop_of_an_idle_printer_is_not_done_before_it_says_something() {
    let mut desk = at_hand();
    desk.press("!");
    let asked = request(&mut desk);
    // The server's answer may be here before its news.
    desk.hear(Message::Answered(asked, Ok(Answer::Done)));
    assert!(desk.text().contains("no word from the printer yet"), "{}", desk.text());
    let live =
        |activity, says: &str| vec![Live { activity, says: Some(says.to_owned()), done: None, ..printing() }];
    desk.hear(Message::News(News::Lives(live(Activity::Cancelling, "no word"))));
    assert!(desk.text().contains("no word from the printer yet"), "{}", desk.text());
    desk.hear(Message::News(News::Lives(live(Activity::Faulted, "the printer has halted"))));
    let stopped = "left has stopped (emergency stop, 14:30): the printer has halted";
    assert!(desk.text().contains(stopped), "{}", desk.text());
}

#[test]
fn a_print_that_ends_without_a_word_of_the_printer_is_no_confirmation() {
    let mut desk = desk();
    desk.press("!");
    let asked = request(&mut desk);
    let live = Live { activity: Activity::Idle, done: None, ..printing() };
    desk.hear(Message::News(News::Lives(vec![live])));
    desk.hear(Message::Answered(asked, Ok(Answer::Done)));
    assert!(desk.text().contains("but says nothing: look at it"), "{}", desk.text());
}

#[test]
fn a_job_that_fails_by_itself_is_told_until_somebody_has_seen_it() {
    let fail = |seq, n, who: &str| {
        let change = Change::Fail { used_mm3: None };
        let record = record(seq, id(n), JobState::Printing, JobState::Failed, change);
        let why = Reason::try_new("it was made for another printer").unwrap();
        Message::News(News::Record(Box::new(HistoryView { who: who.to_owned(), why, ..record })))
    };
    let mut desk = desk();
    desk.hear(fail(10, 2, "appliance left"));
    desk.hear(fail(11, 3, "Ada"));
    desk.hear(fail(12, 4, "policy lost"));
    let text = desk.text();
    assert!(text.contains("job 02020202 has failed: it was made for another printer"), "{text}");
    assert!(text.contains("job 04040404 has failed") && !text.contains("job 03030303 has failed"), "{text}");
    desk.press("\u{1b}");
    assert!(!desk.text().contains("job 02020202 has failed"));
    let again = record(13, id(4), JobState::Failed, JobState::Queued, Change::Retry);
    desk.hear(Message::News(News::Record(Box::new(again))));
    assert!(desk.text().contains("Nothing awaits you"), "{}", desk.text());
}

#[test]
fn an_emergency_stop_that_is_not_done_says_so() {
    let mut desk = desk();
    desk.press("!");
    let asked = request(&mut desk);
    desk.hear(Message::Answered(asked, Err("it is not printing".to_owned())));
    assert!(desk.text().contains("was NOT done"), "{}", desk.text());
    desk.press("\u{1b}");
    desk.hear(Message::Link(LinkNews::Lost("the connection broke".to_owned())));
    desk.press("!");
    assert_eq!(desk.asked(), []);
    assert!(desk.text().contains("was NOT done"), "{}", desk.text());
}

/// With a real printer that does nothing.
fn at_hand() -> Desk {
    let mut desk = desk();
    let port = Some("/dev/ttyACM0".to_owned());
    let live = Live { activity: Activity::Idle, port, done: None, ends: None, ..printing() };
    desk.hear(Message::News(News::Printers(vec![printer(BedView::Clear, live)])));
    desk.asked();
    desk
}

#[test]
fn the_printer_is_moved_and_heated_by_hand_within_limits() {
    let cases = [
        ("3H", "G28"),
        ("3h", "G91|G0 X-1 F3000|G90"),
        ("3+k", "G91|G0 Y10 F3000|G90"),
        ("3--u", "G91|G0 Z0.1 F300|G90"),
        ("3++++l", "G91|G0 X50 F3000|G90"),
        ("3O", "M104 S0|M140 S0"),
        ("3e200\r\r", "M104 S200"),
        ("3e\r60\r", "M140 S60"),
        ("3f210\r-5\r", "M109 S210|M83|G1 E-5 F150|M82"),
        ("3gM115\r", "M115"),
    ];
    for (keys, lines) in cases {
        let mut desk = at_hand();
        desk.press(keys);
        let lines = lines.split('|').map(str::to_owned).collect();
        assert_eq!(order(&mut desk), (name("left"), Order::Commands(lines)), "{keys}");
    }
    for keys in ["3e281\r\r", "3e\r121\r", "3e\r\r", "3f169\r5\r", "3f210\r101\r", "3f\r\r", "3g\r"] {
        let mut desk = at_hand();
        desk.press(keys);
        assert_eq!(desk.asked(), [], "{keys}");
    }
}

#[test]
fn while_it_prints_nothing_is_moved_by_hand() {
    let mut desk = desk();
    desk.press("3HhjkludeOfgCD");
    assert_eq!((desk.asked(), &desk.state.overlay), (vec![], &None));
}

#[test]
fn lines_that_were_sent_come_back_and_show_what_became_of_them() {
    let mut desk = at_hand();
    desk.press("3gM115\r");
    let asked = request(&mut desk);
    desk.hear(Message::Answered(asked, Ok(Answer::Done)));
    desk.press("G28 X\r");
    let asked = request(&mut desk);
    desk.hear(Message::Answered(asked, Err("it is printing".to_owned())));
    desk.hear(Message::Key(KeyEvent::new(KeyCode::Up, KeyModifiers::NONE)));
    desk.hear(Message::Key(KeyEvent::new(KeyCode::Up, KeyModifiers::NONE)));
    assert_eq!(desk.state.overlay, Some(Overlay::Console("M115".to_owned(), 2)));
    desk.press("\u{1b}");
    let text = desk.text();
    assert!(text.contains("M115  taken") && text.contains("G28 X  it is printing"), "{text}");
}

#[test]
fn a_print_that_begins_takes_a_question_of_the_hand_away() {
    let mut desk = at_hand();
    desk.press("3e200");
    desk.hear(Message::News(News::Lives(vec![printing()])));
    assert_eq!(desk.state.overlay, None);
}
