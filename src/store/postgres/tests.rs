//! The suite on a real server, made for the tests; and what only a server can go through.

mod server;

use super::open::Clock;
use super::*;
use crate::queue::tests::{because, id, loaded, name, operator, ticket};
use crate::queue::{Actor, Break, By, Change, Claimant, Evidence, Request, Said, Subject, Who};
use crate::store::suite::{self, Site, run};
use crate::store::{Store, Which};
use jiff::Timestamp;
use server::Database as Fresh;
use std::path::Path;

impl Site for Fresh {
    type Store = Postgres;
    const CHILD: &'static str = "store::postgres::tests::child";

    fn fresh() -> Option<Self> {
        Self::new()
    }

    fn dir(&self) -> &Path {
        self.folder()
    }

    fn open(dir: &Path) -> Postgres {
        Postgres::by_the_clock_of(Clock::Callers, &server::address_for(dir)).unwrap()
    }
}

suite::every_behaviour!(Fresh);

/// Not a test by itself: what processes of their own do.
#[test]
fn child() {
    suite::child::<Fresh>();
}

/// The whole number; a sample is in the suite.
#[test]
#[ignore = "takes minutes"]
fn five_hundred_kills_lose_nothing_and_print_nothing_twice() {
    let Some(site) = Fresh::new() else { return };
    run(suite::kills(&site, 500));
}

/// A queue of three jobs and a printer that has printed one, and what is changed by hand.
fn found(sql: &str) -> Option<Error> {
    let site = Fresh::new()?;
    run(async {
        let store = Fresh::open(site.dir());
        let left = name("left");
        store.say(left.clone(), Said::Loaded(loaded()), operator(0)).await.unwrap();
        store.say(left.clone(), Said::BedClear(Evidence::Word), operator(0)).await.unwrap();
        for number in 1..=3 {
            store.add(ticket(number), true, operator(0)).await.unwrap();
        }
        store.verify().await.unwrap();
        store.close().await;
    });
    let guards = "ALTER TABLE lumenfab.history DISABLE TRIGGER ALL";
    let again = "ALTER TABLE lumenfab.history ENABLE TRIGGER ALL";
    site.by_hand(&format!("{guards}; {sql}; {again}"));
    let address = server::address_for(site.dir());
    let checked = Postgres::connect(&address).and_then(|store| run(store.verify()));
    Some(checked.expect_err(sql))
}

#[test]
fn whatever_is_changed_by_hand_shows() {
    let two = id(2);
    for (sql, expected) in [
        (
            "UPDATE lumenfab.history SET body = replace(body, 'Ada', 'Eve') WHERE seq = 3".to_owned(),
            Break::Changed { seq: 3 },
        ),
        ("DELETE FROM lumenfab.history WHERE seq = 2".to_owned(), Break::Missing { seq: 2, found: 3 }),
        (
            format!("UPDATE lumenfab.jobs SET urgency = -5 WHERE id = '{two}'"),
            Break::Differs { subject: Subject::Job(two) },
        ),
        (
            format!(
                "UPDATE lumenfab.jobs SET body = replace(body, '\"copies\":1', '\"copies\":2') WHERE id = '{two}'"
            ),
            Break::Differs { subject: Subject::Job(two) },
        ),
    ] {
        let Some(error) = found(&sql) else { return };
        assert!(matches!(&error, Error::History(found) if *found == expected), "{sql}: {error}");
    }
}

#[test]
fn tables_that_are_not_as_they_were_made_are_named() {
    for (sql, named) in [
        ("DROP INDEX lumenfab.jobs_due", "index jobs_due"),
        ("DROP TRIGGER history_is_kept ON lumenfab.history", "trigger history_is_kept"),
        ("ALTER TABLE lumenfab.jobs ADD COLUMN colour TEXT", "column jobs.colour"),
    ] {
        let Some(error) = found(sql) else { return };
        let said = error.to_string();
        assert!(said.contains(named), "{said}");
    }
}

#[test]
fn records_are_neither_changed_nor_taken_out_by_accident() {
    let Some(site) = Fresh::new() else { return };
    run(Fresh::open(site.dir()).add(ticket(1), true, operator(0))).unwrap();
    for sql in [
        "UPDATE lumenfab.history SET body = '{}'",
        "DELETE FROM lumenfab.history",
        "TRUNCATE lumenfab.history",
    ] {
        let refused = site.refused(sql);
        assert!(refused.contains("the history is only added to"), "{sql}: {refused}");
    }
}

#[test]
fn another_programs_schema_and_a_later_version_are_refused_and_left_alone() {
    let Some(site) = Fresh::new() else { return };
    let address = server::address_for(site.dir());
    site.by_hand("CREATE SCHEMA lumenfab; CREATE TABLE lumenfab.songs (title TEXT)");
    assert!(matches!(Postgres::connect(&address), Err(Error::Foreign { .. })));
    site.by_hand("DROP SCHEMA lumenfab CASCADE");
    let store = Postgres::connect(&address).unwrap();
    site.by_hand("UPDATE lumenfab.format SET version = 7");
    assert!(matches!(Postgres::connect(&address), Err(Error::Newer { found: 7, known: 1, .. })));
    // Whoever has it open notices, too.
    assert!(matches!(run(store.head()), Err(Error::Newer { .. })));
    assert!(matches!(run(store.add(ticket(1), true, operator(0))), Err(Error::Newer { .. })));
}

#[test]
fn a_connection_that_broke_is_made_anew() {
    let Some(site) = Fresh::new() else { return };
    let store = Fresh::open(site.dir());
    run(store.add(ticket(1), true, operator(0))).unwrap();
    site.end_sessions();
    run(store.add(ticket(2), true, operator(0))).unwrap();
    assert_eq!(run(store.list(Which::Live, None, 9)).unwrap().len(), 2);
}

#[test]
fn a_server_that_is_not_there_is_named_and_no_password_is() {
    let address = "postgresql://ada:secret-word@127.0.0.1:9/queue";
    let error = Postgres::connect(address).unwrap_err();
    assert_eq!(error.code(), "store.server");
    let said = error.to_string();
    assert!(said.starts_with("postgresql://127.0.0.1/queue: ") && !said.contains("secret-word"), "{said}");
    let error = Postgres::connect("postgresql://ada:secret-word@[host").unwrap_err();
    assert!(!error.to_string().contains("secret-word"), "{error}");
    assert_eq!(error.code(), "store.address");
}

/// Hosts whose clocks are an hour off in both directions, on one server.
#[test]
fn claims_live_by_the_servers_clock() {
    let Some(site) = Fresh::new() else { return };
    let store = Postgres::connect(&server::address_for(site.dir())).unwrap();
    let hour = jiff::SignedDuration::from_hours(1);
    let (slow, fast) = (Timestamp::now() - hour, Timestamp::now() + hour);
    let by = |now| By { who: Who::Operator(name("Ada")), why: because("so"), now };
    run(async {
        store.say(name("left"), Said::Loaded(loaded()), by(slow)).await.unwrap();
        store.say(name("left"), Said::BedClear(Evidence::Word), by(fast)).await.unwrap();
        store.add(ticket(1), true, by(slow)).await.unwrap();
        let taken = store.claim(Claimant::Printer(name("left")), slow).await.unwrap().unwrap();
        assert!(taken.claim.until > Timestamp::now() && taken.claim.until < fast);
        // Nobody whose clock is fast takes it away.
        assert_eq!(store.sweep(fast).await.unwrap(), []);
        let actor = Actor::Holder { claim: taken.claim.clone(), asked_by: None };
        let lay = Request { change: Change::Lay, actor, why: because("so"), now: fast };
        store.change(taken.job.id, lay).await.unwrap();
        store.verify().await.unwrap();
    });
}
