//! Work on one case: its stages, each done only when something it is made from has changed.

use super::atomic;
use super::case::{Case, CaseError, MadeFrom, Staging, Told};
use super::error::Error;
use super::event::{Event, EventSink, Stage, StageOutcome};
use super::seal::Standing;
use super::settings::{CaseFile, SeriesKey, Settings, Source, SourceName};
use super::source::{Places, Sources};
use super::stages::report::{NamedScan, ReportPlace};
use super::stages::slice::Sliced;
use crate::ct::{self, SeriesName, Volume, Warning};
use crate::printer::control::Controls;
use crate::progress::{CancelToken, Task};
use crate::sections::SectionStack;
use crate::segment::Candidate;
use crate::solid::Solid;
use crate::topology;
use serde::Serialize;
use std::cell::OnceCell;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What a face gives to the work it starts.
#[derive(Clone)]
pub struct Context<'a> {
    /// Where events go.
    pub events: &'a EventSink<'a>,
    /// Set to stop the work.
    pub cancel: CancelToken,
    /// What the operator asks of a print while it runs.
    pub controls: Controls,
    /// Where the CTs of cases lie.
    pub sources: Sources,
}

impl std::fmt::Debug for Context<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Context").field("cancel", &self.cancel).finish_non_exhaustive()
    }
}

/// What became of a case.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outcome {
    /// The case directory.
    pub case: PathBuf,
    /// Its generated name.
    pub id: String,
    /// The stages that were asked for, in order.
    pub stages: Vec<StageOutcome>,
    /// Vessels that were found by themselves, the one that was taken first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub candidates: Vec<Candidate>,
    /// How many branches, splits, merges, births, deaths and holes the solid has, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub topology: Option<topology::Summary>,
    /// The report, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub report: Option<ReportPlace>,
    /// The picture of the solid, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view: Option<PathBuf>,
}

impl Outcome {
    /// Whether the report's gate failed.
    #[must_use]
    pub fn gate_failed(&self) -> bool {
        self.report.as_ref().is_some_and(|r| !r.passed)
    }
}

/// What a stage made, before it is part of the case.
pub(crate) struct Made {
    pub(crate) staging: Staging,
    pub(crate) summary: String,
    pub(crate) warnings: Vec<Warning>,
}

/// Results that later stages of the same process need, so that they are not read or made again.
#[derive(Default)]
pub(crate) struct Held {
    pub(crate) volume: Option<Volume>,
    pub(crate) sections: Option<SectionStack>,
    pub(crate) solid: Option<Solid>,
    pub(crate) sliced: Option<Sliced>,
}

/// A case being worked on.
pub struct Session<'a> {
    pub(crate) case: Case,
    /// Where its CT lies, where that is known.
    pub(crate) ct: Option<PathBuf>,
    /// Where its ready segmentation lies, where that is known.
    pub(crate) ready: Option<PathBuf>,
    /// Whether the operator has named one of them, so that it has to be remembered.
    ct_is_named: bool,
    /// Of the CT's files: they may be many.
    pub(crate) ct_hash: OnceCell<String>,
    pub(crate) ready_hash: OnceCell<String>,
    pub(crate) context: Context<'a>,
    pub(crate) held: Held,
    pub(crate) candidates: Vec<Candidate>,
    pub(crate) topology: Option<topology::Summary>,
    pub(crate) report: Option<ReportPlace>,
    /// A scan of the replica to be compared with.
    pub(crate) scan: Option<NamedScan>,
    /// The picture of the solid that was written.
    pub(crate) view: Option<PathBuf>,
    pub(crate) gives_up_print: bool,
    /// Stages that were found or made up to date in this session.
    fresh: Vec<Stage>,
    outcomes: Vec<StageOutcome>,
}

impl std::fmt::Debug for Session<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session").field("case", &self.case).finish_non_exhaustive()
    }
}

impl<'a> Session<'a> {
    /// Opens the case at `dir`, with the parameters of `changes` put over its own.
    ///
    /// # Errors
    /// [`Error`] where there is no case, or a parameter cannot be used.
    pub fn open(dir: &Path, changes: CaseFile, context: Context<'a>) -> Result<Self, Error> {
        let mut case = Case::open(dir)?;
        check_ct(changes.ct.as_deref())?;
        check_ready(changes.segmentation.as_deref())?;
        let changes = series_looked_up(changes, case.id(), &context)?;
        let named = changes.named_source();
        let before = CaseFile::of_case(case.id(), case.settings());
        let is_a_part = before.source == Some(SourceName::CtAndSegmentation)
            && matches!(named, Some(SourceName::Ct | SourceName::Segmentation));
        if named.is_some() && named != before.source && !is_a_part {
            return Err(CaseError::OtherSource(dir.to_owned()).into());
        }
        let named = Places { ct: changes.ct.clone(), segmentation: changes.segmentation.clone() };
        // A case of which nothing came is begun anew by whoever names its source again: what was taken out of a case file is out.
        let is_anew = changes.named_source().is_some() && !case.has_results();
        let below = if is_anew { CaseFile { source: before.source, ..CaseFile::default() } } else { before };
        let settings = Settings::try_from(CaseFile { ct: None, segmentation: None, ..changes }.over(below))?;
        case.set_settings(settings);
        let mut session = Self::new(case, named, context);
        let known = session.context.sources.recall(session.case.id());
        session.ct = session.ct.take().or(known.ct);
        session.ready = session.ready.take().or(known.segmentation);
        if session.ct_is_named {
            session.refuse_other_source()?;
        }
        Ok(session)
    }

    /// Another CT may be another patient's: a case keeps the one it was made from.
    fn refuse_other_source(&self) -> Result<(), Error> {
        let known = |name| self.case.made_from(Stage::Segment).and_then(|m| m.get(name));
        let is_other = known("ct").map_or(Ok(false), |k| self.ct_hash().map(|h| h != *k))?
            || known("segmentation").map_or(Ok(false), |k| self.ready_hash().map(|h| h != *k))?;
        if is_other { Err(CaseError::OtherSource(self.case.dir().to_owned()).into()) } else { Ok(()) }
    }

    /// Starts a case at `dir`; nothing is written before its first stage is done, or refused with something to look at.
    ///
    /// # Errors
    /// [`Error`] where something else is in its place, or a parameter is missing or cannot be used.
    pub fn create(dir: &Path, parameters: CaseFile, context: Context<'a>) -> Result<Self, Error> {
        check_ct(parameters.ct.as_deref())?;
        check_ready(parameters.segmentation.as_deref())?;
        let named = Places { ct: parameters.ct.clone(), segmentation: parameters.segmentation.clone() };
        let id = new_id();
        let settings = Settings::try_from(series_looked_up(parameters, &id, &context)?)?;
        let case = Case::create(dir, id, settings)?;
        Ok(Self::new(case, named, context))
    }

    fn new(mut case: Case, named: Places, context: Context<'a>) -> Self {
        if let Some(key) = context.sources.key_file() {
            case.seal_with(key);
        }
        Self {
            case,
            ct_is_named: named != Places::default(),
            ct: named.ct,
            ready: named.segmentation,
            ct_hash: OnceCell::new(),
            ready_hash: OnceCell::new(),
            context,
            held: Held::default(),
            candidates: Vec::new(),
            topology: None,
            report: None,
            view: None,
            scan: None,
            gives_up_print: false,
            fresh: Vec::new(),
            outcomes: Vec::new(),
        }
    }

    /// Opens the case at `dir`, or starts one where there is none.
    ///
    /// # Errors
    /// As [`Session::open`] and [`Session::create`].
    pub fn open_or_create(dir: &Path, parameters: CaseFile, context: Context<'a>) -> Result<Self, Error> {
        if super::case::is_case(dir) {
            Self::open(dir, parameters, context)
        } else {
            Self::create(dir, parameters, context)
        }
    }

    /// Every stage, in order.
    ///
    /// # Errors
    /// [`Error`] of the stage that failed; what the stages before it made stays.
    pub fn run(&mut self) -> Result<(), Error> {
        self.check_printer()?;
        self.spare_the_print(Stage::Slice)?;
        self.segment()?;
        self.solid()?;
        self.slice()?;
        self.print()?;
        self.report()
    }

    /// What was done.
    #[must_use]
    pub fn into_outcome(self) -> Outcome {
        Outcome {
            case: self.case.dir().to_owned(),
            id: self.case.id().to_owned(),
            stages: self.outcomes,
            candidates: self.candidates,
            topology: self.topology,
            report: self.report,
            view: self.view,
        }
    }

    /// The parameters of the case.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        self.case.settings()
    }

    /// Does a stage, unless nothing it is made from has changed since it was last done.
    pub(crate) fn stage(
        &mut self,
        stage: Stage,
        work: impl FnOnce(&mut Self, &Task<'_>) -> Result<Made, Error>,
    ) -> Result<(), Error> {
        self.case.standing()?;
        let made_from = self.made_from(stage)?;
        match self.case.outdated(stage, &made_from)? {
            None => self.skip(stage),
            Some(because_of) => self.redo(stage, &made_from, because_of, work),
        }
    }

    pub(crate) fn is_fresh(&self, stage: Stage) -> bool {
        self.fresh.contains(&stage)
    }

    pub(crate) fn set_fresh(&mut self, stage: Stage) {
        self.fresh.push(stage);
    }

    /// Says that there is nothing to do for a stage.
    pub(crate) fn skip(&mut self, stage: Stage) -> Result<(), Error> {
        self.case.keep_settings()?;
        self.remember_ct();
        let Told { summary, warnings } = self.case.told(stage);
        let because_of = Vec::new();
        self.ended(StageOutcome { stage, done: false, because_of, elapsed_s: 0.0, summary, warnings });
        Ok(())
    }

    /// Does a stage.
    pub(crate) fn redo(
        &mut self,
        stage: Stage,
        made_from: &MadeFrom,
        because_of: Vec<String>,
        work: impl FnOnce(&mut Self, &Task<'_>) -> Result<Made, Error>,
    ) -> Result<(), Error> {
        let standing = self.case.standing()?;
        let events = self.context.events;
        events(Event::Started(stage));
        if standing == Standing::OfAnother {
            let text = "the case was sealed by another installation; with this stage it is sealed by this one: see first with `lumenfab verify CASE --key KEY` that it is as it left there";
            let warning = Warning::new("app.other_seal", text);
            events(Event::Warned { stage, warning });
        }
        let clock = Stopwatch::start();
        let sink = move |done, total| events(Event::Progress { stage, done, total });
        let task = Task::new(&sink, self.context.cancel.clone());
        if stage == Stage::Report {
            self.case.check_journal()?;
        }
        let goes_on_from_sealed = self.case.journal_problem()?.is_none();
        let made = work(self, &task).map_err(Error::or_interrupted);
        if made.is_err() && stage == Stage::Print && goes_on_from_sealed {
            self.keep_broken_print();
        }
        let made = made?;
        // What a printer has laid down cannot be taken back: that it did so is kept, however late the request came.
        if stage != Stage::Print {
            task.check()?;
        }
        let told = Told { summary: made.summary, warnings: made.warnings };
        self.case.commit(stage, made_from, made.staging, told.clone())?;
        self.remember_ct();
        let elapsed_s = clock.elapsed_s();
        let Told { summary, warnings } = told;
        self.ended(StageOutcome { stage, done: true, because_of, elapsed_s, summary, warnings });
        Ok(())
    }

    /// Why the print broke off matters more than that its journal could not be sealed.
    fn keep_broken_print(&mut self) {
        if let Err(e) = self.case.keep_broken_print() {
            let warning = Warning::new("app.journal_not_sealed", e.to_string());
            (self.context.events)(Event::Warned { stage: Stage::Print, warning });
        }
    }

    fn ended(&mut self, outcome: StageOutcome) {
        for warning in &outcome.warnings {
            (self.context.events)(Event::Warned { stage: outcome.stage, warning: warning.clone() });
        }
        (self.context.events)(Event::Ended(outcome.clone()));
        self.set_fresh(outcome.stage);
        self.outcomes.push(outcome);
    }

    /// Says what a stage is at.
    pub(crate) fn note(&self, stage: Stage, text: impl Into<String>) {
        (self.context.events)(Event::Note { stage, text: text.into() });
    }

    pub(crate) fn remember_ct(&mut self) {
        let named = std::mem::take(&mut self.ct_is_named);
        let places = Places { ct: self.ct.clone(), segmentation: self.ready.clone() };
        if !named || places == Places::default() {
            return;
        }
        if let Err(e) = self.context.sources.remember(self.case.id(), &places) {
            // The case is complete without it; only a later segmentation will ask for --ct.
            let warning = Warning { code: "app.source_not_kept".into(), text: e.to_string() };
            (self.context.events)(Event::Warned { stage: Stage::Segment, warning });
        }
    }

    /// Whether the case has a CT at all.
    pub(crate) fn has_image(&self) -> bool {
        !matches!(self.settings().source, Source::Sections | Source::Ready { has_ct: false, .. })
    }

    /// Whether the case was started from ready contours, which are what they are.
    pub(crate) fn brings_contours(&self) -> bool {
        matches!(self.settings().source, Source::Sections)
    }
}

/// Refuses a CT that is not there before anything is made.
fn check_ct(ct: Option<&Path>) -> Result<(), Error> {
    match ct {
        Some(path) if !path.exists() => Err(Error::CtMissing(path.to_owned())),
        _ => Ok(()),
    }
}

/// The parameters with the number of a series in the place of its UID, which is forgotten here.
fn series_looked_up(parameters: CaseFile, id: &str, context: &Context<'_>) -> Result<CaseFile, Error> {
    let Some(SeriesKey::Uid(uid)) = &parameters.series else { return Ok(parameters) };
    let Some(ct) = parameters.ct.clone().or_else(|| context.sources.recall(id).ct) else {
        return Ok(parameters);
    };
    let task = Task::new(&|_, _| {}, context.cancel.clone());
    let mark = ct::reader::find(&ct, &SeriesName::Uid(uid.clone()), id, &task)?;
    Ok(CaseFile { series: Some(SeriesKey::Number(mark.number)), ..parameters })
}

/// Refuses a ready segmentation that is not there before anything is made.
fn check_ready(path: Option<&Path>) -> Result<(), Error> {
    match path {
        Some(path) if !path.exists() => Err(Error::SegmentationMissing(path.to_owned())),
        _ => Ok(()),
    }
}

/// The hash of parameters, in their written form.
pub(crate) fn hash_of(parameters: &impl Serialize) -> String {
    let text = serde_json::to_vec(parameters).expect("parameters are numbers, names and lists of them");
    atomic::hash_of_bytes(&text)
}

/// A name that tells when the case was started, and nothing else: time and chance.
fn new_id() -> String {
    uuid::Uuid::now_v7().to_string()
}

/// How long something takes.
pub(crate) struct Stopwatch(Instant);

impl Stopwatch {
    #[expect(
        clippy::disallowed_methods,
        reason = "this is an edge: how long stages take is told to the operator"
    )]
    pub(crate) fn start() -> Self {
        Self(Instant::now())
    }

    pub(crate) fn elapsed_s(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }
}
