//! The commands: flags to parameters, results to text.

use super::args::{
    Cli, Command, ExportArgs, PhantomArgs, PrintArgs, ProfilesCommand, ResumeArgs, RunArgs, SafeOffArgs,
    SegmentArgs, SliceArgs, SolidArgs,
};
use super::face::{Face, error_document};
use super::keys::{self, Keys};
use super::{Answer, Failure, queue, serve, signals, tui};
use crate::app::errand::{Errand, Told};
use crate::app::settings::{CaseFile, SourceName};
use crate::app::source::Sources;
use crate::app::{self, Context, Deflection, Error, Event, Export, ModelJob, Outcome, Session, case};
use crate::ct::SeriesChoice;
use crate::printer::control::Controls;
use crate::printer::paper::port_kept;
use crate::progress::Task;
use crate::{ct, phantom, profile};
use clap::Parser;
use serde_json::json;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Where `lumenfab run` puts its case where nothing is said.
const DEFAULT_OUT: &str = "lumenfab-case";
/// Exit code of a report whose gate failed.
const GATE_FAILED: u8 = 3;
/// Exit code of work that the operator stopped.
const INTERRUPTED: u8 = 130;

/// Runs a command to its exit code.
pub(super) fn run(cli: Cli) -> u8 {
    let face = Face::new(cli.json);
    let command = match cli.command.unwrap_or_else(|| Command::Run(default_run())) {
        // A server has signals of its own.
        Command::Serve(args) => return answered(&face, serve::run(&args)),
        Command::Queue(args) => return answered(&face, queue::run(&args)),
        Command::Tui(args) => return answered(&face, tui::run(&args, cli.json)),
        Command::Backup(args) => return answered(&face, serve::backup(&args)),
        Command::Restore(args) => return answered(&face, serve::restore(&args)),
        Command::SafeOff(SafeOffArgs { state: Some(dir), watch, .. }) => {
            return answered(&face, serve::safe_off(&dir, watch));
        }
        Command::Doctor(args) => return examined(&face, serve::doctor(&args)),
        command => command,
    };
    let events = |event: Event| face.event(event);
    let controls = Controls::default();
    let cancel = signals::cancel_on_signal(&controls);
    let context = Context { events: &events, cancel, controls, sources: Sources::of_user() };
    let done = match command {
        Command::Run(args) => return run_cases(&args, &face, &context),
        Command::Phantom(args) => make_phantom(&args, &face, &context),
        Command::Inspect { path } => inspect(&path, &face, &context),
        Command::Segment(args) => segment(&args, &face, context),
        Command::Solid(args) => solid(&args, context).map(|o| show_case(&face, &o)),
        Command::Slice(args) => slice(&args, &face, context),
        Command::Print(args) => print(&args, &face, context),
        Command::Resume(args) => resume(&args, &face, context),
        Command::SafeOff(args) => safe_off(&args, &face, &context),
        Command::Report { case, scan, scan_series, dicom, source } => {
            let filed = dicom.as_deref().zip(source.as_deref());
            let choice = scan_series.map_or(SeriesChoice::Only, |n| SeriesChoice::ByNumber(n.get()));
            report(&case, scan.as_deref().map(|path| (path, choice)), filed, context)
                .map(|o| show_case(&face, &o))
        }
        Command::Verify { case, key } => verify(&case, key.as_deref(), &face, &context),
        Command::Export(args) => export(&args, &face, context),
        Command::Profiles(command) => profiles(&command, &face),
        Command::HilSim { args } => return simulate(args),
        Command::Errand => return errand(&face, &context),
        Command::Serve(_)
        | Command::Queue(_)
        | Command::Tui(_)
        | Command::Backup(_)
        | Command::Restore(_)
        | Command::Doctor(_) => {
            unreachable!("they have returned above")
        }
    };
    done.unwrap_or_else(|e| face.failed(&e))
}

fn answered(face: &Face, answer: Result<Answer, Failure>) -> u8 {
    match answer {
        Ok(Answer { document, text }) => {
            face.result(&document, &text);
            0
        }
        Err(Failure { text, code, exit_code }) => face.failure(&text, &code, exit_code),
    }
}

/// The same, of an answer that may be that something does not work.
fn examined(face: &Face, examined: Result<(Answer, bool), Failure>) -> u8 {
    let is_well = !matches!(examined, Ok((_, false)));
    answered(face, examined.map(|(answer, _)| answer)).max(u8::from(!is_well))
}

/// `lumenfab` alone.
fn default_run() -> RunArgs {
    let Ok(Cli { command: Some(Command::Run(args)), .. }) = Cli::try_parse_from(["lumenfab", "run"]) else {
        unreachable!("`run` needs no arguments")
    };
    args
}

/// Only where somebody writes a flag before it: otherwise the arguments never come here.
fn simulate(args: Vec<std::ffi::OsString>) -> u8 {
    let name = std::ffi::OsString::from("hil-sim");
    let code = hil_sim::cli::main_from(std::iter::once(name).chain(args));
    u8::from(code != std::process::ExitCode::SUCCESS)
}

/// Does what a server has asked for on stdin.
fn errand(face: &Face, context: &Context<'_>) -> u8 {
    let mut line = String::new();
    let read = std::io::stdin().read_line(&mut line).map_err(|e| e.to_string());
    let errand = read.and_then(|_n| serde_json::from_str::<Errand>(&line).map_err(|e| e.to_string()));
    match errand {
        Ok(errand) => {
            let tell = |told: Told| super::face::print(&format!("{}\n", json!(told)));
            errand.run(&tell, context);
            0
        }
        Err(problem) => face.usage_error(&format!("stdin: {problem}")),
    }
}

/// A case to run: where it is or will be, and what was said about it.
struct Job {
    dir: PathBuf,
    parameters: CaseFile,
}

fn run_cases(args: &RunArgs, face: &Face, context: &Context<'_>) -> u8 {
    let jobs = match jobs(args) {
        Ok(jobs) => jobs,
        Err(line) => return face.usage_error(&line),
    };
    let _keys = listen(face, context);
    let several = jobs.len() > 1;
    let (mut documents, mut rows) = (Vec::new(), Vec::new());
    let mut text = String::new();
    let mut exit_code = 0;
    let mut jobs = jobs.into_iter();
    while let Some(Named { name, job }) = jobs.next() {
        let code = match job.and_then(|job| run_case(job, args.over.gives_up, context.clone())) {
            Ok(outcome) => {
                text += &case_text(&outcome);
                documents.push(json!(outcome));
                let code = if outcome.gate_failed() { GATE_FAILED } else { 0 };
                rows.push((name, code, result_line(&outcome)));
                code
            }
            Err(e) => {
                face.error(&e);
                let mut document = error_document(&e);
                document["case"] = json!(name);
                documents.push(document);
                rows.push((name, e.exit_code(), e.text_without_sources()));
                e.exit_code()
            }
        };
        exit_code = worse(exit_code, code);
        if context.cancel.is_cancelled() {
            exit_code = if jobs.len() > 0 { INTERRUPTED } else { exit_code };
            break;
        }
    }
    rows.extend(jobs.map(|j| (j.name, INTERRUPTED, "not begun".to_owned())));
    if several {
        text += &table(&rows);
    }
    face.result(&json!({"cases": documents, "exit_code": exit_code}), &text);
    exit_code
}

/// What became of a case, in a few words.
fn result_line(outcome: &Outcome) -> String {
    match &outcome.report {
        Some(report) if report.passed => format!("done: {}", report.index_html.display()),
        Some(report) => format!("the quality gate failed: {}", report.index_html.display()),
        None => "done".to_owned(),
    }
}

/// All cases, one a line: name, exit code, result.
fn table(rows: &[(PathBuf, u8, String)]) -> String {
    let names: Vec<String> = rows.iter().map(|(name, ..)| name.display().to_string()).collect();
    let width = names.iter().map(|n| n.chars().count()).max().unwrap_or(0).max("case".len());
    let mut text = format!("\n{:<width$}  exit  result\n", "case");
    for (name, (_, code, result)) in names.iter().zip(rows) {
        let result = result.split_whitespace().collect::<Vec<_>>().join(" ");
        writeln!(text, "{name:<width$}  {code:>4}  {result}").expect("a string takes every line");
    }
    text
}

/// Of several cases the gravest counts: interrupted, wrong usage, failed, gate failed, done.
fn worse(a: u8, b: u8) -> u8 {
    const ORDER: [u8; 5] = [0, GATE_FAILED, 1, 2, INTERRUPTED];
    let rank = |code| ORDER.iter().position(|&c| c == code).unwrap_or(ORDER.len());
    if rank(b) > rank(a) { b } else { a }
}

fn run_case(job: Job, gives_up_print: bool, context: Context<'_>) -> Result<Outcome, Error> {
    let mut session = Session::open_or_create(&job.dir, job.parameters, context)?;
    session.give_up_broken_off_print(gives_up_print);
    session.run()?;
    Ok(session.into_outcome())
}

/// A case as it was named, and what is to be done for it.
struct Named {
    name: PathBuf,
    job: Result<Job, Error>,
}

type Jobs = Vec<Named>;

fn jobs(args: &RunArgs) -> Result<Jobs, String> {
    if args.cases.is_empty() {
        let mut parameters = args.patch();
        let dir = args.out.clone().unwrap_or_else(|| DEFAULT_OUT.into());
        if parameters.named_source().is_none() && !(args.out.is_some() && case::is_case(&dir)) {
            parameters.source = Some(SourceName::Phantom);
        }
        return Ok(vec![Named { name: dir.clone(), job: Ok(Job { dir, parameters }) }]);
    }
    let cases: Vec<PathBuf> = args.cases.iter().flat_map(|case| case_files(case)).collect();
    if let Some(flag) = args.ct.of_one_patient().filter(|_| cases.len() > 1) {
        return Err(format!("{flag}: found several cases, expected one"));
    }
    let several = cases.len() > 1 || cases != args.cases;
    let named =
        |name: PathBuf| Ok(Named { job: job(&name, args.patch(), args.out.as_deref(), several)?, name });
    let jobs: Jobs = cases.into_iter().map(named).collect::<Result<_, String>>()?;
    refuse_shared_directory(&jobs)?;
    Ok(jobs)
}

/// The case files of a folder that is no case, in the order of their names; anything else as it is.
fn case_files(path: &Path) -> Vec<PathBuf> {
    let entries = if case::is_case(path) { None } else { std::fs::read_dir(path).ok() };
    let is_file = |p: &PathBuf| p.extension().is_some_and(|e| e == "toml") && p.is_file();
    let mut files: Vec<PathBuf> =
        entries.into_iter().flatten().filter_map(|e| Some(e.ok()?.path())).filter(is_file).collect();
    files.sort();
    if files.is_empty() { vec![path.to_owned()] } else { files }
}

/// Two cases in one directory would be two patients in one case.
fn refuse_shared_directory(jobs: &Jobs) -> Result<(), String> {
    let mut seen = BTreeSet::new();
    for Job { dir, .. } in jobs.iter().filter_map(|j| j.job.as_ref().ok()) {
        let place = dir.canonicalize().or_else(|_absent| std::path::absolute(dir));
        if !seen.insert(place.unwrap_or_else(|_unknown| dir.clone())) {
            let shown = dir.display();
            return Err(format!(
                "--out: found {shown} for two cases, expected a directory of its own for each"
            ));
        }
    }
    Ok(())
}

/// What is to be done for a case directory or a case file; `patch` is what the flags say.
fn job(
    path: &Path,
    patch: CaseFile,
    out: Option<&Path>,
    several: bool,
) -> Result<Result<Job, Error>, String> {
    if path.is_dir() {
        if out.is_some() {
            return Err(format!(
                "--out: found it together with the case {}, expected one of the two",
                path.display()
            ));
        }
        // The built-in phantom is for whoever names nothing at all: a folder without a case is a slip.
        if !case::is_case(path) && patch.named_source().is_none() {
            let problem =
                "is a folder without a case file (*.toml): name a case file, a case directory, or a folder \
                           of case files; to start from a CT: run --ct PATH --out DIR"
                    .into();
            return Ok(Err(Error::CaseFile { path: path.to_owned(), problem }));
        }
        return Ok(Ok(Job { dir: path.to_owned(), parameters: patch }));
    }
    if app::is_model(path) {
        return Err(format!(
            "<CASE>: found the model {}, expected a case; a model is sliced by: slice MODEL --out JOB.gcode",
            path.display()
        ));
    }
    let beside = path.with_extension("");
    let dir = match out {
        Some(out) if several => out.join(beside.file_name().unwrap_or_default()),
        Some(out) => out.to_owned(),
        None => beside,
    };
    let job = |file| {
        let parameters: CaseFile = patch.over(file);
        // The built-in phantom is for whoever names no case at all: a file without an image is a slip.
        if parameters.named_source().is_none() && parameters.phantom.is_none() {
            let problem =
                "names no image: expected ct = PATH, segmentation = PATH or a [phantom] table".into();
            return Err(Error::CaseFile { path: path.to_owned(), problem });
        }
        Ok(Job { dir, parameters })
    };
    Ok(app::read_case_file(path).and_then(job))
}

/// One stage on a case directory.
fn stage<'a>(
    case: &Path,
    changes: CaseFile,
    context: Context<'a>,
    work: impl FnOnce(&mut Session<'a>) -> Result<(), Error>,
) -> Result<Outcome, Error> {
    let mut session = Session::open(case, changes, context)?;
    work(&mut session)?;
    Ok(session.into_outcome())
}

/// A report, also filed in the patient's study where a folder for that and the CT are named.
fn report(
    case: &Path,
    scan: Option<(&Path, SeriesChoice)>,
    filed: Option<(&Path, &Path)>,
    context: Context<'_>,
) -> Result<Outcome, Error> {
    stage(case, CaseFile::default(), context, |session| {
        // Before any work: what was told then would stand above a refusal.
        if let Some((_, source)) = filed {
            session.check_source(source)?;
        }
        match scan {
            Some((path, choice)) => session.report_with_scan(path, choice)?,
            None => session.report()?,
        }
        if let Some((dir, source)) = filed {
            session.file_report(source, dir)?;
        }
        Ok(())
    })
}

fn segment(args: &SegmentArgs, face: &Face, context: Context<'_>) -> Result<u8, Error> {
    let (patch, out) = (args.ct.patch(), args.out.as_deref());
    if args.case.is_none() && out.is_none() {
        let line =
            "--out: found neither it nor a case, expected --out CASE to start a case, or a case directory";
        return Ok(face.usage_error(line));
    }
    let mut session = match &args.case {
        // A path that leads nowhere is told as a case that is missing.
        Some(case) if out.is_none() && !case.is_file() => Session::open(case, patch, context)?,
        Some(case) => match job(case, patch, out, false) {
            Ok(job) => {
                let Job { dir, parameters } = job?;
                Session::open_or_create(&dir, parameters, context)?
            }
            Err(line) => return Ok(face.usage_error(&line)),
        },
        None => Session::open_or_create(out.unwrap_or(Path::new(DEFAULT_OUT)), patch, context)?,
    };
    session.give_up_broken_off_print(args.over.gives_up);
    session.segment()?;
    Ok(show_case(face, &session.into_outcome()))
}

fn solid(args: &SolidArgs, context: Context<'_>) -> Result<Outcome, Error> {
    let (Some(out), Some(file)) = (&args.out, &args.sections) else {
        let case = args.case.as_deref().unwrap_or(Path::new(DEFAULT_OUT));
        return stage(case, args.body.patch(), context, |session| build_and_draw(session, args));
    };
    let parameters = CaseFile { source: Some(SourceName::Sections), ..args.body.patch() };
    let mut session = Session::open_or_create(out, parameters, context)?;
    session.import_sections(file)?;
    build_and_draw(&mut session, args)?;
    Ok(session.into_outcome())
}

fn build_and_draw(session: &mut Session<'_>, args: &SolidArgs) -> Result<(), Error> {
    session.give_up_broken_off_print(args.over.gives_up);
    session.solid()?;
    if let Some(path) = &args.matching {
        session.draw_matching(path)?;
    }
    args.view.wanted().map_or(Ok(()), |wanted| session.view(&wanted))
}

fn slice(args: &SliceArgs, face: &Face, context: Context<'_>) -> Result<u8, Error> {
    if app::is_model(&args.case) && !args.case.is_dir() {
        return slice_model(args, face, &context);
    }
    let only_models = [
        ("--perimeters", args.perimeters.is_some()),
        ("--infill-percent", args.infill_percent.is_some()),
        ("--orient", args.orient.is_some()),
    ];
    if let Some((flag, _)) = only_models.iter().find(|(_, given)| *given) {
        let line = format!(
            "{flag}: found it with a case, expected a model; a case is sliced as it lies in its CT, with the perimeters and the infill of its --profile"
        );
        return Ok(face.usage_error(&line));
    }
    if args.case.is_file() {
        let line = format!(
            "<CASE|MODEL>: found the file {}, expected a case directory, or a model that ends in .stl or .3mf",
            args.case.display()
        );
        return Ok(face.usage_error(&line));
    }
    let (out, preview) = (args.out.as_deref(), args.preview.as_deref());
    let outcome = stage(&args.case, args.layer.patch(), context, |session| {
        session.check_targets(out, preview)?;
        session.give_up_broken_off_print(args.over.gives_up);
        session.slice()?;
        out.map_or(Ok(()), |out| session.copy_job(out))?;
        preview.map_or(Ok(()), |dir| session.draw_layers(dir))
    })?;
    face.result(&outcome, &(case_text(&outcome) + &places(out, preview)));
    Ok(0)
}

/// Where the job and its pictures were written to, a line each.
fn places(job: Option<&Path>, pictures: Option<&Path>) -> String {
    let line = |name, path: &Path| format!("{name:<7} {}\n", path.display());
    let job = job.map(|path| line("job", path));
    job.into_iter().chain(pictures.map(|path| line("layers", path))).collect()
}

fn slice_model(args: &SliceArgs, face: &Face, context: &Context<'_>) -> Result<u8, Error> {
    let Some(out) = &args.out else {
        return Ok(face.usage_error("--out: found none, expected the file to write the model's G-code to"));
    };
    let job = ModelJob {
        layer_mm: args.layer.layer_mm.unwrap_or(app::settings::DEFAULT_LAYER_MM),
        profile_name: args.layer.profile.as_deref().unwrap_or(app::settings::DEFAULT_PROFILE),
        perimeters: args.perimeters,
        infill_percent: args.infill_percent,
        turn: args.orient,
        preview: args.preview.as_deref(),
        gives_up_print: args.over.gives_up,
    };
    let sliced = app::slice_model(&args.case, out, &job, context)?;
    let places = places(Some(out), args.preview.as_deref());
    face.result(&sliced, &format!("{sliced}\nprofile {}\n{places}", job.profile_name));
    Ok(0)
}

/// The operator's keys for a print, where there is a terminal.
fn listen(face: &Face, context: &Context<'_>) -> Option<Keys> {
    let keys = Keys::listen(&context.controls)?;
    face.line(keys::HELP);
    Some(keys)
}

fn print(args: &PrintArgs, face: &Face, context: Context<'_>) -> Result<u8, Error> {
    let _keys = listen(face, &context);
    if case::is_case(&args.what) || args.what.is_dir() {
        let changes = CaseFile { profile: args.profile.clone(), ..args.printer.patch() };
        return stage(&args.what, changes, context, |session| session.print_again(args.baud, args.anew))
            .map(|o| show_case(face, &o));
    }
    if app::is_model(&args.what) {
        let line = format!(
            "<CASE|JOB.gcode>: found the model {what}, expected a case or a job; `lumenfab slice {what} --out JOB.gcode` makes one of it",
            what = args.what.display()
        );
        return Ok(face.usage_error(&line));
    }
    let printer = app::FilePrinter {
        profile_name: args.profile.as_deref(),
        port: args.printer.port.as_deref(),
        baud: args.baud,
        beyond_bed: args.beyond_bed,
    };
    let printed = app::print_file(&args.what, printer, args.anew, &context)?;
    face.result(&printed, &format!("{printed}\n"));
    Ok(0)
}

fn resume(args: &ResumeArgs, face: &Face, context: Context<'_>) -> Result<u8, Error> {
    let _keys = listen(face, &context);
    if case::is_case(&args.what) || args.what.is_dir() {
        let changes =
            CaseFile { profile: args.profile.clone(), port: args.port.clone(), ..CaseFile::default() };
        return stage(&args.what, changes, context, |session| {
            session.resume_print(args.baud, args.after_reset)
        })
        .map(|o| show_case(face, &o));
    }
    let printer = app::ResumePrinter {
        profile_name: args.profile.as_deref(),
        port: args.port.as_deref(),
        baud: args.baud,
        after_reset: args.after_reset,
    };
    let printed = app::resume_file(&args.what, printer, &context)?;
    face.result(&printed, &format!("{printed}\n"));
    Ok(0)
}

fn safe_off(args: &SafeOffArgs, face: &Face, context: &Context<'_>) -> Result<u8, Error> {
    // One of port and state is given, and the state directory is not for here.
    let named = args.port.as_deref().unwrap_or_default();
    let printer = app::Printer { profile_name: &args.profile, port: Some(named), baud: args.baud };
    let after = std::time::Duration::from_secs(args.after_s.into());
    let port = port_kept(named);
    face.line(&match args.after_s {
        0 => format!("switches the heaters of the printer on {port} off; it may take half a minute to say so"),
        after_s => format!("switches the heaters of the printer on {port} off in {after_s} s, unless another program has it then"),
    });
    let done = app::safe_off(printer, after, &context.cancel)?;
    face.result(&done, &format!("{done}\n"));
    Ok(0)
}

fn verify(case: &Path, key: Option<&str>, face: &Face, context: &Context<'_>) -> Result<u8, Error> {
    let own = context.sources.key_file();
    let verified = app::seal::verify(case, own.as_ref(), key)?;
    face.result(&verified, &verified.to_string());
    Ok(u8::from(!verified.passed))
}

fn export(args: &ExportArgs, face: &Face, context: Context<'_>) -> Result<u8, Error> {
    let mut session = Session::open(&args.case, CaseFile::default(), context)?;
    let deflection = args.deflection_relative.map(Deflection::Relative);
    let wanted = Export {
        stl: args.stl.clone(),
        three_mf: args.three_mf.clone(),
        step: args.step.clone(),
        sweep: args.sweep.clone(),
        skin: args.skin,
        deflection: deflection.unwrap_or(Deflection::Absolute(args.deflection_mm)),
        colouring: args.colour,
    };
    let exported = session.export(&wanted)?;
    face.result(&exported, &exported.to_string());
    Ok(0)
}

fn make_phantom(args: &PhantomArgs, face: &Face, context: &Context<'_>) -> Result<u8, Error> {
    let params = phantom::Params {
        kind: args.kind,
        polarity: args.polarity,
        noise_hu: args.noise_hu,
        seed: args.noise_seed,
        psf_sigma_mm: args.psf_sigma_mm,
        slab_mm: args.slab_mm,
        pixel_mm: args.pixel_mm,
        n_pixels: args.pixels as usize,
        plane_step_mm: args.plane_step_mm,
        n_planes: args.planes as usize,
        tilt_deg: args.tilt_deg,
        ..phantom::Params::default()
    };
    let task = Task::new(&|_, _| {}, context.cancel.clone());
    params.check_vessel()?;
    phantom::series::write(&args.out, &params, &task)?;
    let seed = phantom::default_seed(&params);
    let document = json!({
        "series": args.out, "truth": args.out.join(phantom::series::TRUTH_FILE), "n_planes": params.n_planes,
        "seed_mm": [seed.x, seed.y, seed.z],
    });
    let text = format!(
        "{} planes in {}\nseed in the lumen: --seed-mm={:.3},{:.3},{:.3}\n",
        params.n_planes,
        args.out.display(),
        seed.x,
        seed.y,
        seed.z
    );
    face.result(&document, &text);
    Ok(0)
}

fn inspect(path: &Path, face: &Face, context: &Context<'_>) -> Result<u8, Error> {
    let task = Task::new(&|_, _| {}, context.cancel.clone());
    let inspection = ct::reader::inspect(path, &task)?;
    // With their paths for the operator who has to find the files; the result has none, and says what needs none.
    let is_told = |fault: &str| inspection.series.iter().any(|s| s.reason.as_deref() == Some(fault));
    for (n, fault) in inspection.faults.iter().enumerate() {
        if !is_told(fault) && !inspection.faults[..n].contains(fault) {
            face.line(&format!("unusable: {fault}"));
        }
    }
    face.result(&inspection, &inspection.to_string());
    Ok(0)
}

fn profiles(command: &ProfilesCommand, face: &Face) -> Result<u8, Error> {
    match command {
        ProfilesCommand::List => {
            let all: Result<Vec<_>, _> = profile::builtin_names().into_iter().map(profile::builtin).collect();
            let all = all?;
            let rows: Vec<_> =
                all.iter().map(|p| json!({"name": p.name, "description": p.description})).collect();
            let mut text = String::new();
            for p in &all {
                writeln!(text, "{:<14} {}", p.name, p.description).expect("a string takes every line");
            }
            face.result(&json!({"profiles": rows}), &text);
        }
        ProfilesCommand::Show { profile } => {
            let profile = profile::load::whole_by_name(profile)?;
            face.result(&profile, &toml::to_string(&profile).expect("a profile can be written as TOML"));
        }
        ProfilesCommand::Detect { port, baud } => {
            let found = app::detect(port, *baud)?;
            let name = found.profile.unwrap_or("no built-in profile speaks its language");
            face.result(&found, &format!("{}\nprofile {name}\n", found.firmware));
            return Ok(u8::from(found.profile.is_none()));
        }
        ProfilesCommand::Check { profiles } => {
            let all: Vec<String> = profile::builtin_names().into_iter().map(str::to_owned).collect();
            let wanted = if profiles.is_empty() { &all } else { profiles };
            let read = wanted.iter().map(|name| profile::load::by_name(name));
            let (checked, faulty): (Vec<_>, Vec<_>) = read.partition(Result::is_ok);
            profile::Error::all_of(faulty.into_iter().filter_map(Result::err).collect())?;
            let checked: Vec<_> = checked.into_iter().filter_map(Result::ok).collect();
            let rows: Vec<_> = checked.iter().map(|p| json!({"name": p.name, "valid": true})).collect();
            let text: String = checked.iter().map(|p| format!("{}: valid\n", p.name)).collect();
            // One profile is told as it always was.
            face.result(&if let [one] = &rows[..] { one.clone() } else { json!({"profiles": rows}) }, &text);
        }
    }
    Ok(0)
}

/// Shows a case and says the exit code.
fn show_case(face: &Face, outcome: &Outcome) -> u8 {
    face.result(outcome, &case_text(outcome));
    if outcome.gate_failed() { GATE_FAILED } else { 0 }
}

fn case_text(outcome: &Outcome) -> String {
    let mut lines = vec![format!("case    {}", outcome.case.display())];
    let times = outcome.stages.iter().filter(|s| s.done);
    let times: Vec<String> = times.map(|s| format!("{} {:.2} s", s.stage, s.elapsed_s)).collect();
    let all_s: f64 = outcome.stages.iter().map(|s| s.elapsed_s).sum();
    if !times.is_empty() {
        lines.push(format!("time    {}; {all_s:.2} s in all", times.join(", ")));
    }
    if !outcome.candidates.is_empty() {
        lines.push(format!("found   {} vessels, the first one taken:", outcome.candidates.len()));
        lines.extend(outcome.candidates.iter().map(|c| format!("        {c}")));
    }
    if let Some(topology) = &outcome.topology {
        lines.push(format!("vessel  {topology}"));
    }
    if let Some(report) = &outcome.report {
        lines.push(format!("report  {}", report.index_html.display()));
        lines.extend(report.headline.iter().map(|line| format!("        {line}")));
    }
    lines.extend(outcome.view.iter().map(|file| format!("view    {}", file.display())));
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_several_cases_the_gravest_exit_code_counts() {
        assert_eq!([0, 3, 1, 0].into_iter().fold(0, worse), 1);
        assert_eq!([3, 0].into_iter().fold(0, worse), 3);
        assert_eq!([1, 130, 2].into_iter().fold(0, worse), 130);
    }

    #[test]
    fn a_folder_of_case_files_stands_for_them() {
        let place = tempfile::tempdir().unwrap();
        let file = |name: &str| {
            let path = place.path().join(name);
            std::fs::write(&path, "").unwrap();
            path
        };
        let (b, a) = (file("b.toml"), file("a.toml"));
        file("notes.txt");
        assert_eq!(case_files(place.path()), [a.clone(), b]);
        assert_eq!(case_files(&a), [a]);
        // One that is a case is that case.
        let own = file(case::CASE_FILE);
        assert_eq!(case_files(own.parent().unwrap()), [place.path()]);
    }

    #[test]
    fn the_table_has_a_line_for_every_case() {
        let rows =
            [("a.toml".into(), 0, "done".to_owned()), ("longer.toml".into(), 1, "no\n vessel".to_owned())];
        let text = table(&rows);
        assert_eq!(
            text,
            "\ncase         exit  result\na.toml          0  done\nlonger.toml     1  no vessel\n"
        );
    }

    #[test]
    fn without_arguments_the_phantom_is_run() {
        let jobs = jobs(&default_run()).unwrap();
        let job = jobs.into_iter().next().unwrap().job.unwrap();
        assert_eq!(
            (job.dir.as_path(), job.parameters.source),
            (Path::new(DEFAULT_OUT), Some(SourceName::Phantom))
        );
    }
}
