//! `lumenfab queue`: a client of the server.

use super::args::queue::{
    AddArgs, BedArgs, EditArgs, MoveArgs, QueueArgs, QueueCommand, SaidArgs, SignOffArgs, SpoolArgs,
};
use super::{Answer, Failure};
use crate::appliance::place::{self, Layout};
use crate::client::{self, Client};
use crate::http::wire::{
    Added, Anew, BedClear, BedView, HistoryPage, JobList, JobView, LoadedBody, Move, NeedsView, PrinterView,
    Schedule, Turn, WishesBody,
};
use crate::queue::{JobId, Name, Reason, State};
use crate::store::Which;
use serde_json::json;
use std::fmt::Write;
use std::path::PathBuf;

/// Jobs among which a name is looked for, of those that are over and of those that are not.
const MOST_LOOKED_AT: u32 = 500;
/// A shorter part of a name is none, characters.
const LEAST_PART: usize = 4;
const WRITES: &str = "a string takes every line";

/// Asks the server, and says what it answered.
pub(super) fn run(args: &QueueArgs) -> Result<Answer, Failure> {
    let dir = match &args.state.state {
        Some(dir) => dir.clone(),
        None => place::default_dir(|name| std::env::var_os(name))?,
    };
    let client = Client::over_socket(Layout::of(dir).socket());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(crate::appliance::Error::Runtime)?;
    runtime.block_on(ask(&client, &args.command))
}

async fn ask(client: &Client, command: &QueueCommand) -> Result<Answer, Failure> {
    client.check_version().await?;
    let job = match command {
        QueueCommand::List { over, most } => {
            let which = if *over { Which::Over } else { Which::Live };
            return Ok(list(&client.jobs(which, None, *most).await?));
        }
        QueueCommand::ClearBed(args) => return clear_bed(client, args).await,
        QueueCommand::Spool(args) => return spool(client, args).await,
        QueueCommand::Plan => return Ok(plan(&client.schedule().await?)),
        QueueCommand::History { job, most } => {
            let page = match job {
                Some(job) => client.history_of(find(client, job).await?, 0, *most).await?,
                None => client.history(0, *most).await?,
            };
            return Ok(history(&page));
        }
        QueueCommand::Add(args) => client.add(&added(args)?).await?,
        QueueCommand::Show(args) => client.job(find(client, &args.job).await?).await?,
        QueueCommand::Submit(args) => turn(client, args, Turn::Submit).await?,
        QueueCommand::Hold(args) => turn(client, args, Turn::Hold).await?,
        QueueCommand::Release(args) => turn(client, args, Turn::Release).await?,
        QueueCommand::Cancel(args) => turn(client, args, Turn::Cancel).await?,
        QueueCommand::Pause(args) => turn(client, args, Turn::Pause).await?,
        QueueCommand::GoOn(args) => turn(client, args, Turn::GoOn).await?,
        QueueCommand::Retry(args) => turn(client, args, Turn::Retry).await?,
        QueueCommand::Move(args) => turn(client, &args.said, Turn::Move(place_of(args))).await?,
        QueueCommand::Edit(args) => edit(client, args).await?,
        QueueCommand::Accept(args) => sign_off(client, args, Turn::Accept).await?,
        QueueCommand::Reject(args) => sign_off(client, args, Turn::Reject).await?,
    };
    Ok(Answer { document: json!(job), text: shown(&job) })
}

/// The server may have another working directory: it is given a whole path.
fn added(args: &AddArgs) -> Result<Added, Failure> {
    let path = std::fs::canonicalize(&args.what)
        .map_err(|source| client::Error::File { path: args.what.clone(), source })?;
    let not_text = |path: PathBuf| Failure {
        text: format!("{}: the path is no text: move the file", path.display()),
        code: "queue.path".to_owned(),
        exit_code: 2,
    };
    let needs = NeedsView { profile: args.profile.clone(), material: args.material.clone(), nozzle_um: None };
    let wishes = WishesBody {
        priority: args.priority,
        not_before: args.not_before,
        copies: args.copies,
        sign_off: args.sign_off,
        needs,
    };
    let path = path.into_os_string().into_string().map_err(|path| not_text(path.into()))?;
    Ok(Added { path, id: None, wishes, submit: !args.draft, why: args.why.clone() })
}

async fn turn(client: &Client, args: &SaidArgs, turn: Turn) -> Result<JobView, Failure> {
    let id = find(client, &args.job.job).await?;
    Ok(client.change(id, &Anew { turn, saw: None, name: None, why: args.why.clone() }).await?)
}

/// What is asked for, one change after the other; each is a record of its own.
fn edits(args: &EditArgs) -> Vec<Turn> {
    let not_before = args.not_before.map(|at| Turn::NotBefore { at: Some(at) });
    let any_time = args.any_time.then_some(Turn::NotBefore { at: None });
    let [priority, copies] = [args.priority.map(Turn::Priority), args.copies.map(Turn::Copies)];
    [priority, copies, not_before, any_time].into_iter().flatten().collect()
}

async fn edit(client: &Client, args: &EditArgs) -> Result<JobView, Failure> {
    let id = find(client, &args.said.job.job).await?;
    for turn in edits(args) {
        client.change(id, &Anew { turn, saw: None, name: None, why: args.said.why.clone() }).await?;
    }
    Ok(client.job(id).await?)
}

async fn sign_off(client: &Client, args: &SignOffArgs, turn: Turn) -> Result<JobView, Failure> {
    let id = find(client, &args.job.job).await?;
    let (name, why) = (Some(args.name.clone()), args.why.clone());
    Ok(client.change(id, &Anew { turn, saw: Some(State::AwaitingSignOff), name, why }).await?)
}

const fn place_of(args: &MoveArgs) -> Move {
    match (args.first, args.before, args.behind) {
        (true, ..) => Move::First,
        (_, Some(job), _) => Move::Before(job),
        (_, _, Some(job)) => Move::Behind(job),
        _ => Move::Last,
    }
}

/// A job by its name, or by a part of it that no other has.
async fn find(client: &Client, text: &str) -> Result<JobId, Failure> {
    if let Ok(id) = text.parse() {
        return Ok(id);
    }
    let mut found = Vec::new();
    for which in [Which::Live, Which::Over] {
        let jobs = client.jobs(which, None, MOST_LOOKED_AT).await?.jobs;
        found.extend(jobs.into_iter().map(|job| job.id).filter(|id| is_part(text, *id)));
    }
    match found[..] {
        [id] => Ok(id),
        _ => Err(Failure {
            text: format!(
                "JOB: found {text}, which {} jobs are called; expected a name of `lumenfab queue list`",
                found.len()
            ),
            code: "queue.no_such_name".to_owned(),
            exit_code: 2,
        }),
    }
}

fn is_part(text: &str, id: JobId) -> bool {
    let id = id.to_string();
    text.len() >= LEAST_PART && (id.starts_with(text) || id.ends_with(text))
}

async fn clear_bed(client: &Client, args: &BedArgs) -> Result<Answer, Failure> {
    let printers = client.printers().await?.printers;
    let printer = the_printer(&printers, args.printer.as_ref())?;
    let on_bed = match printer.bed {
        BedView::Taken(job) => Some(job),
        BedView::Clear | BedView::Unknown => None,
    };
    let word = BedClear { on_bed, name: None, why: args.why.clone() };
    let after = client.clear_bed(&printer.name, &word).await?;
    let text = format!("the bed of {} is clear\n", after.name);
    Ok(Answer { document: json!(after), text })
}

/// What is loaded, with what is said put over it.
fn loaded(before: Option<LoadedBody>, args: &SpoolArgs) -> Result<LoadedBody, Failure> {
    let missing = |flag: &str| Failure {
        text: format!(
            "{flag}: found nothing, and nobody has said so before; expected it beside what is given"
        ),
        code: "queue.not_loaded".to_owned(),
        exit_code: 2,
    };
    let before = before.as_ref();
    let of = |said: &Option<Name>, known: Option<&Name>| said.clone().or_else(|| known.cloned());
    let profile = of(&args.profile, before.map(|b| &b.profile)).ok_or_else(|| missing("--profile"))?;
    let material = args.material.clone().or_else(|| Some(before?.material.clone()));
    let nozzle_um =
        args.nozzle_um.or_else(|| Some(before?.nozzle_um)).ok_or_else(|| missing("--nozzle-um"))?;
    let left_mm3 = match args.left_cm3 {
        Some(cm3) => Some(1000 * u64::from(cm3)),
        None if args.untracked => None,
        None => before.and_then(|b| b.left_mm3),
    };
    Ok(LoadedBody { profile, material: material.ok_or_else(|| missing("--material"))?, nozzle_um, left_mm3 })
}

async fn spool(client: &Client, args: &SpoolArgs) -> Result<Answer, Failure> {
    let printers = client.printers().await?.printers;
    let printer = match (&args.printer, &printers[..]) {
        (None, [only]) => only,
        (named, _) => the_printer(&printers, named.as_ref())?,
    };
    let body = loaded(printer.loaded.clone(), args)?;
    let after = client.load(&printer.name, &body).await?;
    let left = body.left_mm3.map_or_else(
        || "nobody keeps track of how much is left".to_owned(),
        |mm3| format!("{:.1} cm³ left", mm3 as f64 / 1000.0),
    );
    let nozzle_mm = f64::from(body.nozzle_um) / 1000.0;
    let text = format!(
        "{} has {} in a nozzle of {nozzle_mm} mm, profile {}; {left}\n",
        after.name, body.material, body.profile
    );
    Ok(Answer { document: json!(after), text })
}

fn plan(plan: &Schedule) -> Answer {
    let mut text = String::new();
    for next in &plan.next {
        let what = match (&next.job, &next.why_not) {
            (Some(job), _) => format!("prints {job} next"),
            (None, why) => format!("prints nothing next: {}", why.as_deref().unwrap_or("there is no job")),
        };
        writeln!(text, "{}  {what}", next.printer).expect(WRITES);
    }
    for slot in &plan.slots {
        let (job, copy, printer) = (slot.job, slot.copy, &slot.printer);
        writeln!(text, "{:.0}  {:.0}  {job}  copy {copy} on {printer}", slot.starts, slot.ends)
            .expect(WRITES);
    }
    for job in &plan.unplanned {
        writeln!(text, "{}  has no place: {}", job.job, job.why).expect(WRITES);
    }
    if let Some(words) = &plan.ends_words {
        writeln!(text, "{words}").expect(WRITES);
    }
    if plan.is_cut {
        text.push_str("and more, which is not planned yet\n");
    }
    Answer { document: json!(plan), text }
}

fn the_printer<'a>(printers: &'a [PrinterView], named: Option<&Name>) -> Result<&'a PrinterView, Failure> {
    let fits = |printer: &&PrinterView| match named {
        Some(name) => printer.name == *name,
        None => printers.len() == 1 || printer.bed != BedView::Clear,
    };
    let found: Vec<_> = printers.iter().filter(fits).collect();
    if let [one] = found[..] {
        return Ok(one);
    }
    let names: Vec<_> = printers.iter().map(|printer| printer.name.as_str()).collect();
    let text =
        format!("--printer: found {} that it may be, expected one of {}", found.len(), names.join(", "));
    Err(Failure { text, code: "queue.no_printer".to_owned(), exit_code: 2 })
}

fn list(list: &JobList) -> Answer {
    let mut text = String::new();
    for job in &list.jobs {
        writeln!(text, "{}", line(job)).expect(WRITES);
    }
    if list.jobs.is_empty() {
        text.push_str("no jobs\n");
    }
    if list.more {
        text.push_str("and more\n");
    }
    Answer { document: json!(list), text }
}

fn line(job: &JobView) -> String {
    let copies =
        if job.copies > 1 { format!("  copy {} of {}", job.n_printed, job.copies) } else { String::new() };
    let priority = if job.priority == 0 { String::new() } else { format!("  priority {}", job.priority) };
    let holder = job.holder.as_ref().map(|holder| format!("  on {holder}")).unwrap_or_default();
    let kind = json!(job.kind);
    let state = if job.state == State::Queued && !job.is_prepared {
        "queued, to be prepared"
    } else {
        job.state.words()
    };
    format!("{}  {:<22}  {:<5}{priority}{copies}{holder}", job.id, state, kind.as_str().unwrap_or_default())
        .trim_end()
        .to_owned()
}

fn shown(job: &JobView) -> String {
    let mut text = format!("{}\n", line(job));
    if let Some(estimate) = job.estimate {
        let (hours, minutes) = (estimate.print_s / 3600, estimate.print_s / 60 % 60);
        let cm3 = estimate.filament_mm3 as f64 / 1000.0;
        writeln!(text, "takes {hours} h {minutes} min and {cm3:.1} cm³ of filament a copy").expect(WRITES);
    }
    if let Some(at) = job.not_before {
        writeln!(text, "not before {at}").expect(WRITES);
    }
    text
}

fn history(page: &HistoryPage) -> Answer {
    let mut text = String::new();
    for record in &page.records {
        let of = record
            .job
            .map(|job| format!("job {job}"))
            .or_else(|| Some(format!("printer {}", record.printer.as_ref()?)));
        let (of, what, why) = (of.unwrap_or_default(), words(&json!(record.what)), because(&record.why));
        writeln!(text, "{:>6}  {}  {of}: {what} by {}{why}", record.seq, record.at, record.who)
            .expect(WRITES);
    }
    if page.more {
        text.push_str("and more\n");
    }
    Answer { document: json!(page), text }
}

fn because(why: &Reason) -> String {
    if why.is_empty() { String::new() } else { format!(": {why}") }
}

/// A record's change in a word or two: its name in the history, and where it led.
fn words(what: &serde_json::Value) -> String {
    let Some((kind, inner)) = what.as_object().and_then(|what| what.iter().next()) else {
        return String::new();
    };
    let change = match &inner["change"] {
        serde_json::Value::String(name) => Some(name.clone()),
        serde_json::Value::Object(change) => change.keys().next().cloned(),
        _ => None,
    };
    let to = inner["to"].as_str().map(|to| format!(" -> {to}")).unwrap_or_default();
    format!("{}{to}", change.as_ref().unwrap_or(kind))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::args::{Cli, Command};
    use crate::http::wire::{NextView, SlotView, UnplannedView};
    use clap::Parser;

    fn command(args: &[&str]) -> QueueCommand {
        let cli = Cli::try_parse_from([&["lumenfab", "queue"], args].concat()).unwrap();
        let Some(Command::Queue(args)) = cli.command else { panic!("not queue") };
        args.command
    }

    #[test]
    fn what_is_to_be_changed_of_a_job_is_asked_for_piece_by_piece() {
        let turns = |args: &[&str]| {
            let QueueCommand::Edit(args) = command(&[&["edit", "abcd"], args].concat()) else {
                panic!("not edit")
            };
            edits(&args)
        };
        assert_eq!(turns(&["--priority", "-3"]), [Turn::Priority(-3)]);
        let at = "2026-12-24T18:00:00Z";
        let not_before = Turn::NotBefore { at: at.parse().ok() };
        assert_eq!(turns(&["--not-before", at, "--copies", "2"]), [Turn::Copies(2), not_before]);
        assert_eq!(turns(&["--any-time"]), [Turn::NotBefore { at: None }]);
        for wrong in [
            &["edit", "abcd"][..],
            &["edit", "abcd", "--any-time", "--not-before", at],
            &["accept", "abcd", "--why", "good"],
        ] {
            assert!(Cli::try_parse_from([&["lumenfab", "queue"], wrong].concat()).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn what_is_loaded_stays_where_nothing_is_said_about_it() {
        let loaded = |before: Option<LoadedBody>, args: &[&str]| {
            let QueueCommand::Spool(args) = command(&[&["spool"], args].concat()) else {
                panic!("not spool")
            };
            loaded(before, &args).map_err(|failure| failure.text.split(':').next().unwrap().to_owned())
        };
        let name = |text: &str| Name::try_new(text).unwrap();
        let material = |text: &str| crate::queue::Material::try_new(text).unwrap();
        let pla = LoadedBody {
            profile: name("marlin"),
            material: material("PLA"),
            nozzle_um: 400,
            left_mm3: Some(5000),
        };
        let petg = LoadedBody { material: material("PETG"), ..pla.clone() };
        assert_eq!(loaded(Some(pla.clone()), &["--material", "PETG"]), Ok(petg));
        let full = LoadedBody { left_mm3: Some(800_000), ..pla.clone() };
        assert_eq!(loaded(Some(pla.clone()), &["--left-cm3", "800"]), Ok(full));
        let untracked = LoadedBody { left_mm3: None, ..pla.clone() };
        assert_eq!(loaded(Some(pla), &["--untracked"]), Ok(untracked));
        assert_eq!(loaded(None, &["--material", "PLA"]), Err("--profile".to_owned()));
    }

    #[test]
    fn a_plan_says_what_is_next_and_why_others_wait() {
        let left = Name::try_new("left").unwrap();
        let id = JobId::at(jiff::Timestamp::UNIX_EPOCH, [7; 10]);
        let next = NextView { printer: left.clone(), job: None, why_not: Some("take the part off".into()) };
        let (starts, ends) = (jiff::Timestamp::UNIX_EPOCH, jiff::Timestamp::UNIX_EPOCH);
        let slot = SlotView { job: id, copy: 2, printer: left, starts, ends };
        let unplanned = vec![UnplannedView { job: id, why: "it is held".into() }];
        let schedule = Schedule {
            next: vec![next],
            slots: vec![slot],
            unplanned,
            ends: None,
            ends_words: None,
            is_cut: true,
        };
        let expected = format!(
            "left  prints nothing next: take the part off\n1970-01-01T00:00:00Z  1970-01-01T00:00:00Z  {id}  copy 2 on left\n\
             {id}  has no place: it is held\nand more, which is not planned yet\n"
        );
        assert_eq!(plan(&schedule).text, expected);
    }

    fn printer(name: &str, bed: BedView) -> PrinterView {
        PrinterView { name: Name::try_new(name).unwrap(), loaded: None::<LoadedBody>, bed, live: None }
    }

    #[test]
    fn a_bed_is_named_unless_only_one_can_be_meant() {
        let [a, b] = [printer("a", BedView::Clear), printer("b", BedView::Unknown)];
        let chosen = |printers: &[PrinterView], named: Option<&str>| {
            let named = named.map(|name| Name::try_new(name).unwrap());
            the_printer(printers, named.as_ref())
                .map(|printer| printer.name.to_string())
                .map_err(|failure| failure.exit_code)
        };
        let both = [a.clone(), b.clone()];
        assert_eq!(chosen(&both, None), Ok("b".into()));
        assert_eq!(chosen(&both, Some("a")), Ok("a".into()));
        assert_eq!(chosen(&both, Some("c")), Err(2));
        assert_eq!(chosen(&[a], None), Ok("a".into()));
        assert_eq!(chosen(&[b.clone(), printer("c", BedView::Unknown)], None), Err(2));
    }

    #[test]
    fn records_are_told_in_words() {
        let change = json!({ "job": { "id": "x", "change": { "start": { "printer": "a" } }, "from": "queued", "to": "printing" } });
        assert_eq!(words(&change), "start -> printing");
        assert_eq!(words(&json!({ "job": { "change": "lay", "to": "printing" } })), "lay -> printing");
        assert_eq!(words(&json!({ "printer": { "name": "a", "change": "doubt" } })), "doubt");
        assert_eq!(words(&json!({ "added": { "id": "x" } })), "added");
    }

    #[test]
    fn a_part_of_a_name_will_do_where_it_is_long_enough() {
        let id = JobId::at(jiff::Timestamp::UNIX_EPOCH, [7; 10]);
        let text = id.to_string();
        assert!(is_part(&text[..4], id) && is_part(&text[text.len() - 4..], id));
        assert!(!is_part(&text[..3], id) && !is_part("ffffffff", id));
    }
}
