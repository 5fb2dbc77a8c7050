//! Whole screens, letters and styles, as files.

use super::*;
use crate::queue::Bed;
use std::fmt::Write;
use std::path::PathBuf;

/// Letters, then each run of one style: `row:from-to style`, the usual one left out.
fn picture(buffer: &Buffer, theme: Theme) -> String {
    let mut text = lines(buffer).join("\n") + "\n\n";
    let usual = theme.style(crate::tui::theme::Role::Text);
    for (y, cells) in buffer.content.chunks(usize::from(buffer.area.width)).enumerate() {
        let mut x = 0;
        for run in cells.chunk_by(|a, b| a.style() == b.style()) {
            let style = run[0].style();
            let is_usual = style.fg == Some(usual.fg.unwrap_or_default())
                && style.bg == Some(usual.bg.unwrap_or_default())
                && style.add_modifier.is_empty();
            if !is_usual {
                let (fg, bg) = (style.fg.unwrap_or_default(), style.bg.unwrap_or_default());
                let marks = format!("{:?}", style.add_modifier).to_lowercase();
                let marks = marks.replace("modifier(0x0)", "");
                writeln!(text, "{y}:{x}-{} {fg} {bg} {marks}", x + run.len() - 1).unwrap();
            }
            x += run.len();
        }
    }
    text.lines().map(|line| line.trim_end().to_owned() + "\n").collect()
}

fn check(file: &str, desk: &Desk) {
    let found = picture(&desk.draw().0, desk.state.theme);
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden/tui").join(file);
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, &found).unwrap();
    }
    let golden = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(golden == found, "{file} is another one now:\n{found}");
}

const SIZES: [(u16, u16); 3] = [(80, 24), (120, 40), (200, 60)];
const THEMES: [Theme; 3] = [Theme::Dark, Theme::Light, Theme::Plain];

/// In every size, and in every theme in the least size: themes change no letter.
fn check_all(what: &str, prepare: impl Fn(&mut Desk)) {
    for (width, height) in SIZES {
        let mut desk = Desk::printing(width, height, Theme::Dark);
        prepare(&mut desk);
        check(&format!("{what}-{width}x{height}-dark.txt"), &desk);
        let letters = desk.text();
        for theme in THEMES.into_iter().chain([Theme::Contrast]) {
            desk.state.theme = theme;
            assert_eq!(desk.text(), letters, "{what} {width}x{height} {}", theme.name());
        }
    }
    for theme in THEMES.into_iter().skip(1) {
        let mut desk = Desk::printing(80, 24, theme);
        prepare(&mut desk);
        check(&format!("{what}-80x24-{}.txt", theme.name()), &desk);
    }
}

#[test]
fn the_dashboard_while_it_prints() {
    check_all("dashboard", |_| {});
}

#[test]
fn the_queue_with_details() {
    check_all("queue", |desk| {
        desk.press("2j\r");
        let page = crate::http::wire::HistoryPage {
            records: vec![
                record(1, id(2), JobState::Draft, JobState::Queued, Change::Submit),
                record(2, id(2), JobState::Queued, JobState::Held, Change::Hold),
                record(3, id(2), JobState::Held, JobState::Queued, Change::Release),
            ],
            more: false,
        };
        let Some(Effect::Ask(request)) = desk.asked().pop() else { panic!("no history is asked for") };
        desk.hear(Message::Answered(request, Ok(crate::tui::message::Answer::History(page))));
    });
}

#[test]
fn the_question_whether_a_bed_is_clear() {
    check_all("bed-clear", |desk| {
        let live = Live { activity: Activity::Idle, done: None, ends: None, ..printing() };
        desk.hear(Message::News(News::Changed(vec![job(1, JobState::AwaitingBedClear)])));
        desk.hear(Message::News(News::Printers(vec![printer(Bed::Taken(id(1)).into(), live)])));
        desk.press("bclea");
    });
}

#[test]
fn the_printer_by_hand() {
    check_all("printer", |desk| {
        let port = Some("/dev/ttyACM0".to_owned());
        let live = Live { activity: Activity::Idle, port, done: None, ends: None, ..printing() };
        desk.hear(Message::News(News::Printers(vec![printer(BedView::Clear, live)])));
        desk.press("3H+l");
        let Some(Effect::Ask(request)) = desk.asked().pop() else { panic!("nothing is asked for") };
        desk.hear(Message::Answered(request, Ok(crate::tui::message::Answer::Done)));
    });
}

#[test]
fn an_emergency_stop() {
    check_all("emergency-stop", |desk| desk.press("2!"));
}

#[test]
fn all_keys() {
    check_all("help", |desk| desk.press("?"));
}

#[test]
fn the_palette() {
    check_all("palette", |desk| desk.press(":print"));
}

#[test]
fn nothing_runs_here() {
    let mut desk = Desk::new(80, 24, Theme::Dark);
    desk.hear(Message::Link(LinkNews::NoServer));
    check("no-server-80x24-dark.txt", &desk);
    desk.hear(Message::Link(LinkNews::OtherVersion(2)));
    check("other-version-80x24-dark.txt", &desk);
}

#[test]
fn the_connection_is_lost_and_the_printer_has_stopped() {
    let mut desk = Desk::printing(80, 24, Theme::Dark);
    let says = Some("the nozzle does not get warm (printer.heater): look at its plug".to_owned());
    let live = Live { activity: Activity::Faulted, says, done: None, ends: None, ..printing() };
    desk.hear(Message::News(News::Lives(vec![live])));
    desk.hear(Message::Link(LinkNews::Lost("the server has ended or the connection broke".to_owned())));
    check("lost-80x24-dark.txt", &desk);
}

#[test]
fn a_terminal_that_is_too_small() {
    check("small-20x5-dark.txt", &Desk::printing(20, 5, Theme::Dark));
}
