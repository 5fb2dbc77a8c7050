//! What a server has done about cases by a process of its own, which it can end without harm to anything else.
//!
//! The errand comes in as a line of JSON, what happens goes out as lines of JSON, the last one [`Told::Done`] or [`Told::Failed`]. What is
//! told names neither paths nor patients: it goes over a network.

use super::case::{CaseError, is_case};
use super::error::Error;
use super::event::{Event, Stage};
use super::session::{Context, Session};
use super::settings::{CaseFile, SeriesKey};
use super::volume_file;
use super::{atomic, source::Sources};
use crate::ct::{self, SeriesChoice};
use crate::progress::Task;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

/// What is to be done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Errand {
    /// Finds the series of a folder.
    Inspect {
        /// The folder.
        folder: PathBuf,
    },
    /// Writes a series as a [volume file](volume_file), so that single planes of it can be looked at.
    Planes {
        /// The folder.
        folder: PathBuf,
        /// Number of the series, from 1; `None`: the only one.
        series: Option<usize>,
        /// Whether a stack with missing planes is used.
        allow_gaps: bool,
        /// The file.
        to: PathBuf,
    },
    /// Does the stages of a case up to one of them, each only where something it is made from has changed.
    Stages {
        /// The case directory, which need not be there yet.
        case: PathBuf,
        /// The last stage; [`Stage::Print`] is a queue's to do.
        last: Stage,
        /// Put over the case's own.
        parameters: Box<CaseFile>,
        /// Where it is kept which CT a case is of.
        sources: PathBuf,
    },
}

/// What happens.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Told {
    /// Work on a stage began.
    Started {
        /// The stage.
        stage: Stage,
    },
    /// So much of it is done.
    Progress {
        /// Units done.
        done: u64,
        /// Units in all.
        total: u64,
    },
    /// What it is at.
    Note {
        /// In plain words.
        text: String,
    },
    /// Something was odd.
    Warned {
        /// A stable name for programs.
        code: String,
        /// In plain words.
        text: String,
    },
    /// All is done.
    Done {
        /// What came of it.
        result: Value,
    },
    /// It could not be done.
    Failed {
        /// A stable name for programs.
        code: String,
        /// Why, in plain words.
        text: String,
    },
}

impl Errand {
    /// Does it; what happens goes to `tell`.
    pub fn run(self, tell: &(dyn Fn(Told) + Sync), context: &Context<'_>) {
        let hidden = self.hidden();
        let say = |told: Told| tell(hidden.hide(told));
        say(match self.done(&say, context) {
            Ok(result) => Told::Done { result },
            Err(error) => Told::Failed {
                code: error.code().unwrap_or("app.failed").to_owned(),
                text: error.text_without_sources(),
            },
        });
    }

    fn done(self, tell: &(dyn Fn(Told) + Sync), context: &Context<'_>) -> Result<Value, Error> {
        let progress = |done, total| tell(Told::Progress { done, total });
        let task = Task::new(&progress, context.cancel.clone());
        match self {
            Self::Inspect { folder } => {
                let inspection = ct::reader::inspect(&folder, &task)?;
                Ok(json!(inspection))
            }
            Self::Planes { folder, series, allow_gaps, to } => {
                let choice = series.map_or(SeriesChoice::Only, SeriesChoice::ByNumber);
                let options = ct::reader::Options { choice, allow_gaps, z_mm: None };
                let loaded = ct::reader::load_with(&folder, &options, &task)?;
                let failed = |e| CaseError::from(atomic::failed("write", &to)(e));
                let file = std::fs::File::create(&to).map_err(failed)?;
                volume_file::write(&loaded.volume, &mut BufWriter::new(file)).map_err(failed)?;
                Ok(json!({ "warnings": loaded.warnings }))
            }
            Self::Stages { case, last, parameters, sources } => {
                let events = |event| {
                    if let Some(told) = of_event(event) {
                        tell(told);
                    }
                };
                let context =
                    Context { events: &events, sources: Sources::in_dir(sources), ..context.clone() };
                let mut session = if is_case(&case) {
                    Session::open(&case, *parameters, context)?
                } else {
                    Session::create(&case, *parameters, context)?
                };
                let stages = Stage::ALL.into_iter().filter(|s| *s <= last && *s != Stage::Print);
                for stage in stages {
                    match stage {
                        Stage::Segment => session.segment()?,
                        Stage::Solid => session.solid()?,
                        Stage::Slice => session.slice()?,
                        Stage::Print => {}
                        Stage::Report => session.report()?,
                    }
                }
                let outcome = session.into_outcome();
                Ok(
                    json!({ "stages": outcome.stages, "candidates": outcome.candidates, "topology": outcome.topology }),
                )
            }
        }
    }

    /// Its paths, which nobody is told.
    fn hidden(&self) -> Hidden {
        match self {
            Self::Inspect { folder } => Hidden::new([(&**folder, "the folder")]),
            Self::Planes { folder, to, .. } => Hidden::new([(&**folder, "the folder"), (&**to, "the file")]),
            Self::Stages { case, parameters, .. } => {
                let ct = parameters.ct.as_deref().map(|ct| (ct, "the CT"));
                Hidden::new([(&**case, "the case")].into_iter().chain(ct))
            }
        }
    }
}

/// What an operator may say of a case over a network: no paths, and no UID, which would tell whose CT it is.
///
/// # Errors
/// The key that may not be said there.
pub const fn check_parameters(parameters: &CaseFile) -> Result<(), &'static str> {
    let is_uid = matches!(parameters.series, Some(SeriesKey::Uid(_)));
    match parameters {
        CaseFile { format: Some(_), .. } => Err("format"),
        CaseFile { id: Some(_), .. } => Err("id"),
        CaseFile { source: Some(_), .. } => Err("source"),
        CaseFile { ct: Some(_), .. } => Err("ct"),
        CaseFile { segmentation: Some(_), .. } => Err("segmentation"),
        CaseFile { label: Some(_), .. } => Err("label"),
        CaseFile { port: Some(_), .. } => Err("port"),
        _ if is_uid => Err("series"),
        _ => Ok(()),
    }
}

fn of_event(event: Event) -> Option<Told> {
    Some(match event {
        Event::Started(stage) => Told::Started { stage },
        Event::Progress { done, total, .. } => Told::Progress { done, total },
        Event::Note { text, .. } => Told::Note { text },
        Event::Warned { warning, .. } => Told::Warned { code: warning.code, text: warning.text },
        Event::Told { code, text, .. } => Told::Warned { code: code.to_owned(), text },
        // Its warnings were told one by one, its summary stands in the result.
        Event::Ended(_) => return None,
    })
}

/// Paths with what they are called instead.
#[derive(Debug)]
pub(crate) struct Hidden(Vec<(String, &'static str)>);

impl Hidden {
    pub(crate) fn new<'a>(paths: impl IntoIterator<Item = (&'a Path, &'static str)>) -> Self {
        Self(paths.into_iter().map(|(path, name)| (path.display().to_string(), name)).collect())
    }

    fn hide(&self, told: Told) -> Told {
        match told {
            Told::Note { text } => Told::Note { text: self.text(&text) },
            Told::Warned { code, text } => Told::Warned { code, text: self.text(&text) },
            Told::Failed { code, text } => Told::Failed { code, text: self.text(&text) },
            Told::Done { result } => Told::Done { result: self.value(result) },
            other @ (Told::Started { .. } | Told::Progress { .. }) => other,
        }
    }

    /// Words without the paths that are known; up to any other, for nobody knows where that one ends.
    pub(crate) fn text(&self, text: &str) -> String {
        let known =
            self.0.iter().fold(text.to_owned(), |text, (path, name)| text.replace(path.as_str(), name));
        let is_path = |word: &&str| word.trim_start_matches(['"', '\'', '(']).starts_with('/');
        let mut words: Vec<_> = known.split(' ').take_while(|word| !is_path(word)).collect();
        if words.len() < known.split(' ').count() {
            words.push("(a path)");
        }
        words.join(" ")
    }

    fn value(&self, value: Value) -> Value {
        match value {
            Value::String(text) => Value::String(self.text(&text)),
            Value::Array(values) => values.into_iter().map(|value| self.value(value)).collect(),
            Value::Object(values) => {
                values.into_iter().map(|(key, value)| (key, self.value(value))).collect()
            }
            other => other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phantom;
    use std::sync::Mutex;

    fn told(errand: Errand) -> Vec<Told> {
        let heard = Mutex::new(Vec::new());
        let context = Context {
            events: &|_| {},
            cancel: Default::default(),
            controls: Default::default(),
            sources: Sources::in_dir(PathBuf::from("/nonexistent")),
        };
        errand.run(&|told| heard.lock().unwrap().push(told), &context);
        heard.into_inner().unwrap()
    }

    #[test]
    fn what_is_told_names_no_path() {
        let hidden = Hidden(vec![("/ct/MEIER JOSEF".into(), "the folder"), ("/cases/1".into(), "the case")]);
        let hide = |text: &str| hidden.text(text);
        assert_eq!(hide("/ct/MEIER JOSEF: no series"), "the folder: no series");
        assert_eq!(hide("pictures are in /cases/1/planes"), "pictures are in the case/planes");
        assert_eq!(hide("see \"/other/HUBER ANNA/x.png\" too"), "see (a path)");
        assert_eq!(hide("20 mm/s and 1/2"), "20 mm/s and 1/2");
        let done = hidden.hide(Told::Done { result: json!({ "a": ["/ct/MEIER JOSEF"], "n": 1 }) });
        assert_eq!(done, Told::Done { result: json!({ "a": ["the folder"], "n": 1 }) });
    }

    #[test]
    fn a_folder_is_inspected_and_one_that_holds_no_ct_says_so_without_its_name() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("MEIER");
        std::fs::create_dir(&folder).unwrap();
        let all = told(Errand::Inspect { folder });
        let last = all.last().unwrap();
        assert!(matches!(last, Told::Done { .. } | Told::Failed { .. }), "{last:?}");
        assert!(!format!("{all:?}").contains("MEIER"), "{all:?}");
    }

    #[test]
    fn a_series_becomes_planes_that_can_be_looked_at_one_by_one() {
        let dir = tempfile::tempdir().unwrap();
        let (folder, to) = (dir.path().join("ct"), dir.path().join("planes"));
        let params = phantom::Params::default();
        phantom::series::write(&folder, &params, &Task::quiet()).unwrap();
        let all =
            told(Errand::Planes { folder: folder.clone(), series: None, allow_gaps: false, to: to.clone() });
        assert!(matches!(all.last(), Some(Told::Done { .. })), "{all:?}");
        let volume = ct::reader::load(&folder, &SeriesChoice::Only, &Task::quiet()).unwrap().volume;
        let mut planes = volume_file::Planes::open(&to).unwrap();
        assert_eq!(planes.dims(), volume.dims);
        let k = volume.dims[2] / 2;
        assert_eq!(planes.plane(k).unwrap(), volume.plane(k).to_vec());
    }

    #[test]
    fn paths_and_uids_are_no_parameters_of_a_network() {
        assert_eq!(check_parameters(&CaseFile { wall_mm: Some(1.0), ..CaseFile::default() }), Ok(()));
        let ct = CaseFile { ct: Some("/etc".into()), ..CaseFile::default() };
        assert_eq!(check_parameters(&ct), Err("ct"));
        let uid = CaseFile { series: Some(SeriesKey::Uid("1.2.3".into())), ..CaseFile::default() };
        assert_eq!(check_parameters(&uid), Err("series"));
        let port = CaseFile { port: Some("/dev/ttyACM0".into()), ..CaseFile::default() };
        assert_eq!(check_parameters(&port), Err("port"));
    }
}
