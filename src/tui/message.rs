//! What can happen to the terminal UI, and what it can ask for.

use super::command::Command;
use crate::http::wire::{
    Anew, BedClear, HistoryPage, HistoryView, JobView, Live, Ordered, PrinterView, Said, Schedule, Status,
    Whoami,
};
use crate::queue::{JobId, Name};
use crate::store::Which;
use jiff::Timestamp;
use ratatui::crossterm::event::KeyEvent;
use ratatui::layout::Size;

/// Something that has happened.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Message {
    /// A key was pressed.
    Key(KeyEvent),
    /// Something on the screen was clicked.
    Click(Target),
    /// The wheel was turned by so many rows, downwards where positive.
    Scroll(i32),
    /// The terminal has another size.
    Resize(Size),
    /// So late is it.
    Tick(Timestamp),
    /// Of the connection.
    Link(LinkNews),
    /// Of the server.
    News(News),
    /// What was asked for is done, or refused: in plain words.
    Answered(Request, Result<Answer, String>),
}

/// What is heard of the connection.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum LinkNews {
    /// There is a server, and it is looked at.
    Up(Box<Status>, Whoami),
    /// No server runs here.
    NoServer,
    /// It speaks another version.
    OtherVersion(u32),
    /// The connection is lost, or was refused: why, in plain words.
    Lost(String),
}

/// What is heard over the connection.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum News {
    /// All jobs of a listing; whether there are more than these.
    Jobs(Which, Vec<JobView>, bool),
    /// Some jobs, as they are now.
    Changed(Vec<JobView>),
    /// All printers.
    Printers(Vec<PrinterView>),
    /// What printers of this server are doing.
    Lives(Vec<Live>),
    /// A record was made.
    Record(Box<HistoryView>),
    /// The plan.
    Schedule(Box<Schedule>),
}

/// What is asked of the server.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Request {
    /// A change of a job; with the change that takes it back, where there is one.
    Change(JobId, Anew, Option<crate::http::wire::Turn>),
    /// The word that a bed is clear.
    ClearBed(Name, BedClear),
    /// The word that a bed may not be clear.
    DoubtBed(Name, Said),
    /// An order to a printer itself.
    Order(Name, Ordered),
    /// What happened to a job.
    History(JobId),
    /// To be started: there is none.
    Start,
}

/// What comes back.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Answer {
    /// It is done, or begun.
    Done,
    /// What happened to a job.
    History(HistoryPage),
}

/// What is to be done outside.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Effect {
    /// The end.
    Quit,
    /// To be asked of the server.
    Ask(Request),
}

/// What a place on the screen stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Target {
    /// A command.
    Command(Command),
    /// A row of the list that is shown, counted from its first one.
    Row(usize),
    /// A row of the palette.
    Choice(usize),
}
