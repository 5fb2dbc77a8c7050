//! The queue in SQLite: what opening it, and taking, listing and adding a job costs, by the length of the queue.
//!
//! On a file system in memory where there is one, so that the work is measured and not the disk; `QUEUE_BENCH_DIR` names another
//! folder, for the latency of a real disk.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use jiff::{SignedDuration, Timestamp};
use lumenfab::queue::{
    Actor, By, Change, Claim, Claimant, Digest, Estimate, Evidence, JobId, Loaded, Made, Material, Name,
    Needs, Reason, Request, Said, Spec, SpecKind, State, Ticket, Who, Wishes,
};
use lumenfab::store::{Sqlite, Store, Which};
use std::hint::black_box;
use std::path::Path;
use tokio::runtime::Runtime;

const LENGTHS: [u32; 3] = [10, 1_000, 100_000];

fn at(seconds: i64) -> Timestamp {
    Timestamp::UNIX_EPOCH + SignedDuration::from_secs(1_800_000_000 + seconds)
}

fn name(text: &str) -> Name {
    Name::try_new(text).expect("a good name")
}

fn by() -> By {
    By { who: Who::Operator(name("Ada")), why: Reason::default(), now: at(0) }
}

fn ticket(number: u32, material: &str) -> Ticket {
    let [a, b, c, d] = number.to_be_bytes();
    let needs = Needs { material: Material::try_new(material).ok(), ..Needs::default() };
    let estimate = Estimate { print_s: 3600, filament_mm3: 10_000 };
    Ticket {
        id: JobId::at(at(0), [0, 0, 0, 0, 0, 0, a, b, c, d]),
        spec: Spec::try_new(SpecKind::Gcode, vec![a, b, c, d]).expect("short"),
        wishes: Wishes::default(),
        made: Some(Made { gcode: Digest::of(b"G28"), estimate, needs }),
    }
}

/// A queue of `n` jobs for a printer that is ready; all before the last one may need another material.
struct Bench {
    runtime: Runtime,
    store: Sqlite,
    dir: tempfile::TempDir,
}

impl Bench {
    fn new(n: u32, material: &str) -> Self {
        let in_memory = Path::new("/dev/shm");
        let named = std::env::var_os("QUEUE_BENCH_DIR").map(std::path::PathBuf::from);
        let parent = named.or_else(|| in_memory.is_dir().then(|| in_memory.to_owned()));
        let dir = parent.map_or_else(tempfile::tempdir, tempfile::tempdir_in).expect("a folder");
        let runtime = tokio::runtime::Builder::new_current_thread().build().expect("a runtime");
        let store = Sqlite::open(&dir.path().join("queue.db")).expect("a new file");
        let bench = Self { runtime, store, dir };
        bench.fill(n, material);
        bench
    }

    fn fill(&self, n: u32, material: &str) {
        let (profile, abs) = (name("abs-enclosed"), Material::try_new("ABS").expect("a material"));
        let loaded = Loaded { profile, material: abs, nozzle_um: 400, left_mm3: None };
        let tickets = (1..n).map(|number| ticket(number, material)).chain([ticket(n, "ABS")]).collect();
        self.run(async {
            self.store.add_all(tickets, true, by()).await?;
            self.store.say(name("left"), Said::Loaded(loaded), by()).await?;
            self.store.say(name("left"), Said::BedClear(Evidence::Word), by()).await
        });
    }

    fn run<T>(&self, work: impl Future<Output = Result<T, lumenfab::store::Error>>) -> T {
        self.runtime.block_on(work).expect("nothing is refused here")
    }

    fn take(&self) -> Claim {
        let claimed = self.run(self.store.claim(Claimant::Printer(name("left")), at(1)));
        claimed.expect("there is a job").claim
    }

    fn give_back(&self, claim: Claim) {
        let (job, actor) = (claim.job, Actor::Holder { claim, asked_by: None });
        let change = Change::GiveBack { lost: false };
        self.run(self.store.change(job, Request { change, actor, why: Reason::default(), now: at(2) }));
    }

    /// Adds a job and calls it off.
    fn add_and_cancel(&self, number: u32) {
        let (ticket, actor) =
            (ticket(number, "ABS"), Actor::Operator { name: name("Ada"), saw: State::Queued });
        let (job, change) = (ticket.id, Change::Cancel { used_mm3: None });
        self.run(self.store.add(ticket, true, by()));
        self.run(self.store.change(job, Request { change, actor, why: Reason::default(), now: at(2) }));
    }
}

fn queue(c: &mut Criterion) {
    let mut group = c.benchmark_group("queue");
    group.sample_size(30);
    for n in LENGTHS {
        let bench = Bench::new(n, "ABS");
        group.bench_function(BenchmarkId::new("take_and_give_back", n), |b| {
            b.iter(|| bench.give_back(bench.take()));
        });
        group.bench_function(BenchmarkId::new("renew", n), |b| {
            let claim = bench.take();
            b.iter(|| black_box(bench.run(bench.store.renew(claim.clone(), at(3)))));
            bench.give_back(claim);
        });
        group.bench_function(BenchmarkId::new("list_50", n), |b| {
            b.iter(|| black_box(bench.run(bench.store.list(Which::Live, None, 50))));
        });
        let mut number = n;
        group.bench_function(BenchmarkId::new("add_and_cancel", n), |b| {
            b.iter(|| {
                number += 1;
                bench.add_and_cancel(number);
            });
        });
        group.bench_function(BenchmarkId::new("open", n), |b| {
            b.iter(|| black_box(Sqlite::open(&bench.dir.path().join("queue.db")).expect("a good file")));
        });
        let others = Bench::new(n, "PLA");
        group.bench_function(BenchmarkId::new("take_behind_all_that_do_not_fit", n), |b| {
            b.iter(|| others.give_back(others.take()));
        });
    }
    group.finish();
}

criterion_group!(benches, queue);
criterion_main!(benches);
