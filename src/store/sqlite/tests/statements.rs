//! A crash between any two statements, and how statements find their rows.

use super::*;
use crate::queue::tests::{because, loaded};
use crate::queue::{Evidence, Head};
use rusqlite::trace::{TraceEvent, TraceEventCodes};
use std::sync::{Arc, Mutex};

/// What each statement of a connection is begun with.
fn watch(db: &mut Db, mut seen: impl FnMut(&str) + Send + 'static) -> Result<(), Error> {
    let told = move |event: TraceEvent<'_>| {
        if let TraceEvent::Stmt(_, sql) = event {
            seen(sql);
        }
    };
    db.connection.trace_v2(TraceEventCodes::SQLITE_TRACE_STMT, Some(told)).unwrap();
    Ok(())
}

fn holder(claim: &Claim, change: Change) -> Request {
    let actor = Actor::Holder { claim: claim.clone(), asked_by: None };
    Request { change, actor, why: because("so"), now: at(2) }
}

/// One of everything that writes, in turn; `before` is called in front of each.
async fn one_of_everything(store: &Sqlite, mut before: impl AsyncFnMut()) {
    let left = name("left");
    let printer = Claimant::Printer(left.clone());
    before().await;
    store.say(left.clone(), Said::Loaded(loaded()), operator(0)).await.unwrap();
    before().await;
    store.say(left.clone(), Said::BedClear(Evidence::Word), operator(0)).await.unwrap();
    for number in 1..=2 {
        before().await;
        store.add(ticket(number), true, operator(0)).await.unwrap();
    }
    let actor = Actor::Operator { name: name("Ada"), saw: State::Queued };
    before().await;
    store.place(id(1), Place::Last, actor.clone(), Reason::default(), at(1)).await.unwrap();
    before().await;
    store.claim(printer.clone(), at(0)).await.unwrap().unwrap();
    before().await;
    store.sweep(at(1000)).await.unwrap();
    before().await;
    store.claim(printer, at(1)).await.unwrap().unwrap();
    before().await;
    let claim = store.adopt(left.clone(), at(1)).await.unwrap()[0].claim.clone();
    for change in [Change::Lay, Change::Printed { used_mm3: None }] {
        before().await;
        store.change(claim.job, holder(&claim, change)).await.unwrap();
    }
    before().await;
    store.say(left, Said::BedClear(Evidence::Word), operator(3)).await.unwrap();
    before().await;
    let hold = Request { change: Change::Hold, actor, why: Reason::default(), now: at(4) };
    store.change(id(1), hold).await.unwrap();
}

#[test]
fn a_crash_between_any_two_statements_leaves_all_of_a_change_or_nothing() {
    let folder = Folder::new();
    let images = tempfile::tempdir().unwrap();
    let n_images = Arc::new(Mutex::new(0));
    run(async {
        let store = Folder::open(folder.dir());
        let (from, to, count) = (folder.dir().to_owned(), images.path().to_owned(), Arc::clone(&n_images));
        let keep_image = move |_: &str| {
            let mut count = count.lock().unwrap();
            let image = to.join(count.to_string());
            fs::create_dir(&image).unwrap();
            for file in ["queue.db", "queue.db-wal"] {
                fs::copy(from.join(file), image.join(file)).unwrap();
            }
            *count += 1;
        };
        store.on_thread(|db| watch(db, keep_image)).await.unwrap();
        let heads = Mutex::new(Vec::new());
        let look = async || {
            let head = store.head().await.unwrap();
            heads.lock().unwrap().push(head);
        };
        one_of_everything(&store, look).await;
        let heads = heads.into_inner().unwrap();
        let n_images = *n_images.lock().unwrap();
        assert!(n_images > 100 && heads.is_sorted_by(|a, b| a.seq < b.seq));
        for image in 0..n_images {
            assert_whole(&images.path().join(image.to_string()), &heads).await;
        }
    });
}

/// What is found after the crash is what was there between two changes.
async fn assert_whole(image: &Path, heads: &[Head]) {
    let store = Folder::open(image);
    store.verify().await.unwrap();
    let head = store.head().await.unwrap();
    assert!(heads.contains(&head), "{}: {head:?}", image.display());
    store.close().await;
}

#[test]
fn no_statement_looks_at_all_jobs_or_sorts_them() {
    let folder = Folder::new();
    let seen = Arc::new(Mutex::new(Vec::new()));
    let heard = Arc::clone(&seen);
    run(async {
        let store = Folder::open(folder.dir());
        let hear = move |sql: &str| heard.lock().unwrap().push(sql.to_owned());
        store
            .on_thread({
                let hear = hear.clone();
                |db| watch(db, hear)
            })
            .await
            .unwrap();
        store.on_reader(|db| watch(db, hear)).await.unwrap();
        one_of_everything(&store, async || {}).await;
        store.claim(Claimant::Worker(name("w")), at(9)).await.unwrap();
        for which in [Which::Live, Which::Over] {
            store.list(which, None, 9).await.unwrap();
        }
        store.history(Some(Subject::Job(id(1))), 2, 9).await.unwrap();
        store.history(None, 2, 9).await.unwrap();
        store.job(id(1)).await.unwrap();
    });
    let db = Connection::open(folder.db()).unwrap();
    let mut seen = seen.lock().unwrap().clone();
    seen.retain(|sql| ["SELECT", "UPDATE", "DELETE"].iter().any(|verb| sql.trim_start().starts_with(verb)));
    seen.sort();
    seen.dedup();
    assert!(seen.len() > 15, "{seen:#?}");
    for sql in seen {
        let mut explained = db.prepare(&format!("EXPLAIN QUERY PLAN {sql}")).unwrap();
        let mut steps = explained.raw_query();
        while let Some(step) = steps.next().unwrap() {
            let step: String = step.get(3).unwrap();
            let is_flat = !step.contains("TEMP B-TREE")
                && (!step.starts_with("SCAN")
                    || (step.contains("USING") && sql.contains("LIMIT 1"))
                    || ["needs", "printers"].iter().any(|few| step.ends_with(few)));
            assert!(is_flat, "{sql}\n{step}");
        }
    }
}
