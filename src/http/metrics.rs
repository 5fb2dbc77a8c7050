//! `GET /metrics`: what the server does, in the text format of Prometheus (version 0.0.4).

use super::access::Viewer;
use super::appliance::Appliance;
use super::error::Problem;
use super::printers;
use super::wire::{Activity, BedView, PrinterView};
use crate::queue::state::Kind;
use crate::queue::{Job, State};
use crate::store::{Store, Which};
use axum::extract;
use axum::http::header;
use axum::response::IntoResponse;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Live jobs that are counted.
const MOST_COUNTED: u32 = 10_000;
const WRITES: &str = "writing to a string cannot fail";
/// The text format.
const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// What was done since the start. Clones are the same.
#[derive(Debug, Clone, Default)]
pub struct Counters(Arc<Inner>);

#[derive(Debug, Default)]
struct Inner {
    prints: [AtomicU64; 4],
    prepared: [AtomicU64; 2],
    restarts: AtomicU64,
}

/// Ends of prints that are counted.
const ENDS: [(Kind, &str); 4] = [
    (Kind::Printed, "printed"),
    (Kind::Fail, "failed"),
    (Kind::Cancel, "cancelled"),
    (Kind::GiveBack, "given-back"),
];

impl Counters {
    /// A print has ended so.
    pub fn count_print(&self, end: Kind) {
        if let Some(idx) = ENDS.iter().position(|(kind, _)| *kind == end) {
            self.0.prints[idx].fetch_add(1, Relaxed);
        }
    }

    /// A preparation has ended so.
    pub fn count_prepared(&self, end: Kind) {
        self.0.prepared[usize::from(end != Kind::Prepared)].fetch_add(1, Relaxed);
    }

    /// A part of the server was started again.
    pub fn count_restart(&self) {
        self.0.restarts.fetch_add(1, Relaxed);
    }
}

/// What the server does, in numbers.
pub(super) async fn metrics<S: Store>(
    extract::State(app): extract::State<Appliance<S>>,
    _viewer: Viewer,
) -> Result<impl IntoResponse, Problem> {
    let jobs = app.store.list(Which::Live, None, MOST_COUNTED).await?;
    let head = app.store.head().await?;
    let mut families = Families::default();
    families.add(RECORDS, &[], head.seq as f64);
    families.jobs(&jobs);
    families.counters(&app.counters);
    printers::all(&app).await?.iter().for_each(|printer| families.printer(printer));
    families.add(STREAMS, &[], app.events.n_readers() as f64);
    families.add(STARTED, &[], app.started().as_second() as f64);
    if let Some(bytes) = resident_bytes() {
        families.add(RESIDENT, &[], bytes as f64);
    }
    Ok(([(header::CONTENT_TYPE, CONTENT_TYPE)], families.text()))
}

/// Resident memory, as Linux tells it.
fn resident_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kib: u64 = line.trim().strip_suffix(" kB")?.parse().ok()?;
    Some(kib << 10)
}

/// A name, its type, and what it is.
type Family = (&'static str, &'static str, &'static str);

const RECORDS: Family = ("lumenfab_records_total", "counter", "Records of the queue's history.");
const JOBS: Family = ("lumenfab_jobs", "gauge", "Jobs that are not over, by state.");
const PRINTS: Family = ("lumenfab_prints_total", "counter", "Prints since the start, by their end.");
const PREPARED: Family =
    ("lumenfab_preparations_total", "counter", "Preparations since the start, by their end.");
const RESTARTS: Family =
    ("lumenfab_restarts_total", "counter", "Parts of the server that were started again.");
const BED: Family = ("lumenfab_bed_clear", "gauge", "Whether the bed is known to be clear.");
const PRINTING: Family = ("lumenfab_printing", "gauge", "Whether a print is under way.");
const DONE: Family = ("lumenfab_print_done", "gauge", "Part of the print that is done, 0 to 1.");
const ACTUAL: Family = ("lumenfab_temperature_celsius", "gauge", "Temperature of a heater.");
const TARGET: Family = ("lumenfab_target_celsius", "gauge", "What a heater is set to.");
const STREAMS: Family = ("lumenfab_event_streams", "gauge", "Readers of events.");
const STARTED: Family = ("process_start_time_seconds", "gauge", "When the server started, s since 1970.");
const RESIDENT: Family = ("process_resident_memory_bytes", "gauge", "Resident memory, bytes.");

/// Values by family: those of one stand together.
#[derive(Debug, Default)]
struct Families(BTreeMap<Family, String>);

impl Families {
    fn add(&mut self, family: Family, labels: &[(&str, &str)], value: f64) {
        let labels: Vec<_> =
            labels.iter().map(|(name, value)| format!("{name}=\"{}\"", escaped(value))).collect();
        let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
        let values = self.0.entry(family).or_default();
        writeln!(values, "{}{labels} {value}", family.0).expect(WRITES);
    }

    fn text(&self) -> String {
        let block = |((name, kind, help), values): (&Family, &String)| {
            format!("# HELP {name} {help}\n# TYPE {name} {kind}\n{values}")
        };
        self.0.iter().map(block).collect()
    }

    fn jobs(&mut self, jobs: &[Job]) {
        for state in State::ALL.into_iter().filter(|state| !state.is_over()) {
            let n = jobs.iter().filter(|job| job.state == state).count();
            self.add(JOBS, &[("state", state.words())], n as f64);
        }
    }

    fn counters(&mut self, counters: &Counters) {
        let Inner { prints, prepared, restarts } = &*counters.0;
        for (count, (_, end)) in prints.iter().zip(ENDS) {
            self.add(PRINTS, &[("end", end)], count.load(Relaxed) as f64);
        }
        for (count, end) in prepared.iter().zip(["prepared", "failed"]) {
            self.add(PREPARED, &[("end", end)], count.load(Relaxed) as f64);
        }
        self.add(RESTARTS, &[], restarts.load(Relaxed) as f64);
    }

    fn printer(&mut self, printer: &PrinterView) {
        let name = ("printer", printer.name.as_str());
        let flag = |is: bool| f64::from(u8::from(is));
        self.add(BED, &[name], flag(printer.bed == BedView::Clear));
        let Some(live) = &printer.live else { return };
        self.add(
            PRINTING,
            &[name],
            flag(!matches!(live.activity, Activity::Offline | Activity::Idle | Activity::Faulted)),
        );
        if let Some(done) = live.done {
            self.add(DONE, &[name], done);
        }
        for (heater, heat) in [("hotend", live.hotend), ("bed", live.bed)] {
            let Some(heat) = heat else { continue };
            self.add(ACTUAL, &[name, ("heater", heater)], heat.actual_c);
            self.add(TARGET, &[name, ("heater", heater)], heat.target_c);
        }
    }
}

fn escaped(value: &str) -> String {
    value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::wire::{Heat, Live};
    use crate::queue::{Name, Printer};

    #[test]
    fn values_of_a_family_stand_together_under_one_heading() {
        let mut families = Families::default();
        let counters = Counters::default();
        counters.count_print(Kind::Printed);
        counters.count_print(Kind::Printed);
        counters.count_prepared(Kind::Fail);
        families.counters(&counters);
        for text in ["left", "the \"right\" one"] {
            let name = Name::try_new(text).unwrap();
            let hotend = Some(Heat { actual_c: 209.5, target_c: 210.0 });
            let live = Live {
                activity: Activity::Printing,
                done: Some(0.25),
                hotend,
                ..Live::offline(name.clone())
            };
            families.printer(&PrinterView::new(&Printer::new(name), Some(&live)));
        }
        let text = families.text();
        for line in [
            "lumenfab_prints_total{end=\"printed\"} 2",
            "lumenfab_preparations_total{end=\"failed\"} 1",
            "lumenfab_temperature_celsius{printer=\"left\",heater=\"hotend\"} 209.5",
            "lumenfab_print_done{printer=\"the \\\"right\\\" one\"} 0.25",
            "lumenfab_bed_clear{printer=\"left\"} 0",
        ] {
            assert!(text.lines().any(|found| found == line), "{line} is not in:\n{text}");
        }
        let names: Vec<_> = text
            .lines()
            .filter(|line| !line.starts_with('#'))
            .map(|line| line.split(['{', ' ']).next())
            .collect();
        let mut grouped = names.clone();
        grouped.dedup();
        grouped.sort_unstable();
        let n_groups = grouped.len();
        grouped.dedup();
        assert_eq!(grouped.len(), n_groups, "{names:?}");
    }
}
