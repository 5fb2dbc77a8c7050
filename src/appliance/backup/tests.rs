use super::*;
use crate::queue::tests::{at, loaded, name, operator, ticket};
use crate::queue::{Bed, Claimant, Evidence, Said, Ticket};
use std::os::unix::fs::MetadataExt;

/// A state directory with two queued jobs and a draft, as a server leaves it, its store still open.
async fn state(dir: &Path) -> Sqlite {
    std::fs::create_dir_all(dir.join("jobs/a")).unwrap();
    std::fs::create_dir(dir.join("files")).unwrap();
    std::fs::write(dir.join("config.toml"), "[[printer]]\nname = \"left\"\n").unwrap();
    std::fs::write(dir.join("jobs/a/job.gcode"), "G28\n".repeat(50_000)).unwrap();
    std::fs::write(dir.join("files/b.gcode"), "").unwrap();
    std::fs::write(dir.join("owner.lock"), "").unwrap();
    symlink("/etc/hostname", dir.join("files/link")).unwrap();
    let store = Sqlite::open(&dir.join("queue.db")).unwrap();
    for number in 1..=3 {
        store.add(ticket(number), number != 3, operator(0)).await.unwrap();
    }
    store
}

async fn states(dir: &Path) -> Vec<State> {
    let store = Sqlite::open(&dir.join("queue.db")).unwrap();
    let mut states: Vec<State> = all_live(&store).await.unwrap().iter().map(|job| job.state).collect();
    states.sort();
    store.close().await;
    states
}

#[tokio::test]
async fn what_was_saved_beside_a_living_server_is_restored_with_its_jobs_held() {
    let root = tempfile::tempdir().unwrap();
    let (dir, file, new) =
        (root.path().join("state"), root.path().join("b.zip"), root.path().join("deep/new"));
    let store = state(&dir).await;
    let saved = backup(&dir, &file, at(10)).unwrap();
    assert_eq!((saved.n_files, saved.bytes), (4, file.metadata().unwrap().len()));
    assert_eq!(file.metadata().unwrap().mode() & 0o777, 0o600);
    // What comes after it is not in it; the server goes on.
    store.add(ticket(4), true, operator(0)).await.unwrap();
    store.close().await;
    let restored = restore(&file, &new, at(20)).await.unwrap();
    assert_eq!(restored, Restored { made_at: at(10), n_files: 4, n_held: 2 });
    assert_eq!(states(&new).await, [State::Draft, State::Held, State::Held]);
    let same = |name: &str| {
        assert_eq!(std::fs::read(new.join(name)).unwrap(), std::fs::read(dir.join(name)).unwrap())
    };
    ["config.toml", "jobs/a/job.gcode", "files/b.gcode"].into_iter().for_each(same);
    assert!(!new.join("files/link").exists() && !new.join("owner.lock").exists());
    let of_state = new.metadata().unwrap().mode() & 0o777;
    assert_eq!((of_state, new.join("queue.db").metadata().unwrap().mode() & 0o777), (0o700, 0o600));
    let store = Sqlite::open(&new.join("queue.db")).unwrap();
    let history = store.history(None, 0, 100).await.unwrap();
    let last = &history.last().unwrap().body;
    assert!(last.contains(&format!("restored from the backup of {}: see whether", at(10))), "{last}");
    store.verify().await.unwrap();
    store.close().await;
    assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 3, "nothing else is left");
}

#[tokio::test]
async fn nothing_is_restored_over_anything_and_nothing_of_a_damaged_backup() {
    let root = tempfile::tempdir().unwrap();
    let (dir, file, new) = (root.path().join("state"), root.path().join("b.zip"), root.path().join("new"));
    state(&dir).await.close().await;
    backup(&dir, &file, at(10)).unwrap();
    let refused = restore(&file, &dir, at(20)).await.unwrap_err();
    assert!(refused.to_string().contains("holds something already: move it aside"), "{refused}");
    let whole = std::fs::read(&file).unwrap();
    let damaged = root.path().join("damaged.zip");
    // Any byte: where it does not matter the same comes back, and else nothing.
    for k in (0..whole.len()).step_by(whole.len() / 97) {
        let mut bytes = whole.clone();
        bytes[k] ^= 0x15;
        std::fs::write(&damaged, &bytes).unwrap();
        match restore(&damaged, &new, at(20)).await {
            Ok(restored) => {
                assert_eq!((restored.n_files, states(&new).await.len()), (4, 3), "byte {k}");
                std::fs::remove_dir_all(&new).unwrap();
            }
            Err(error) => {
                assert!(matches!(error, Error::Backup { .. } | Error::Io { .. }), "byte {k}: {error}")
            }
        }
        assert!(!new.exists(), "byte {k}");
    }
    for cut in [0, 1, 100, whole.len() / 2, whole.len() - 1] {
        std::fs::write(&damaged, &whole[..cut]).unwrap();
        let refused = restore(&damaged, &new, at(20)).await.unwrap_err().to_string();
        assert!(refused.contains("is no backup of lumenfab, or only a part of one"), "{refused}");
    }
    assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 3, "nothing half-made is left");
}

#[tokio::test]
async fn a_name_that_leads_out_of_the_directory_is_refused() {
    let root = tempfile::tempdir().unwrap();
    for name in ["../evil", "/etc/evil", "jobs/../../evil", "owner.lock", "jobs", "filesx/a"] {
        assert_eq!(placed(root.path(), name), None, "{name}");
    }
    assert_eq!(placed(root.path(), "jobs/a/job.gcode"), Some(root.path().join("jobs/a/job.gcode")));
    let file = root.path().join("evil.zip");
    let mut zip = ZipWriter::new(File::create(&file).unwrap());
    let entry = |name: &str| Entry {
        name: name.to_owned(),
        bytes: 1,
        blake3: blake3::hash(b"x").to_hex().to_string(),
    };
    for name in [QUEUE, "../evil"] {
        zip.start_file(name, SimpleFileOptions::default()).unwrap();
        zip.write_all(b"x").unwrap();
    }
    zip.start_file(MANIFEST, SimpleFileOptions::default()).unwrap();
    let entries = vec![entry("../evil"), entry(QUEUE)];
    let manifest = Manifest { format: 1, made_by: String::new(), made_at: at(0), entries, cases: Vec::new() };
    serde_json::to_writer(&mut zip, &manifest).unwrap();
    zip.finish().unwrap();
    let refused = restore(&file, &root.path().join("new/state"), at(0)).await.unwrap_err().to_string();
    assert!(refused.contains("names a file outside the state directory"), "{refused}");
    assert!(!root.path().join("evil").exists() && !root.path().join("new/evil").exists());
}

#[tokio::test]
async fn a_backup_needs_a_queue_and_a_place_of_its_own() {
    let root = tempfile::tempdir().unwrap();
    let refused = backup(root.path(), &root.path().join("../b.zip"), at(0)).unwrap_err().to_string();
    assert!(refused.contains("holds no queue"), "{refused}");
    let dir = root.path().join("state");
    state(&dir).await.close().await;
    let refused = backup(&dir, &dir.join("b.zip"), at(0)).unwrap_err().to_string();
    assert!(refused.contains("belongs on another disk"), "{refused}");
    assert!(matches!(backup(&dir, &root.path().join("nowhere/b.zip"), at(0)), Err(Error::Io { .. })));
}

#[tokio::test]
async fn what_was_in_hand_is_held_and_no_bed_is_believed() {
    let root = tempfile::tempdir().unwrap();
    let (dir, file, new) = (root.path().join("state"), root.path().join("b.zip"), root.path().join("new"));
    let store = state(&dir).await;
    for printer in ["left", "right", "spare"] {
        store.say(name(printer), Said::Loaded(loaded()), operator(1)).await.unwrap();
        store.say(name(printer), Said::BedClear(Evidence::Word), operator(1)).await.unwrap();
    }
    store.add(Ticket { made: None, ..ticket(4) }, true, operator(1)).await.unwrap();
    let claim = async |claimant| store.claim(claimant, at(5)).await.unwrap().unwrap();
    let prepared = claim(Claimant::Worker(name("worker"))).await.job.id;
    let warming = claim(Claimant::Printer(name("left"))).await.job.id;
    let laid = claim(Claimant::Printer(name("right"))).await;
    let actor = Actor::Holder { claim: laid.claim, asked_by: None };
    let lay = Request { change: Change::Lay, actor, why: Reason::default(), now: at(6) };
    store.change(laid.job.id, lay).await.unwrap();
    store.close().await;
    backup(&dir, &file, at(7)).unwrap();
    // Claims of then are good still.
    let restored = restore(&file, &new, at(8)).await.unwrap();
    assert_eq!(restored.n_held, 2);
    let store = Sqlite::open(&new.join("queue.db")).unwrap();
    for (id, state) in [(prepared, State::Held), (warming, State::Held), (laid.job.id, State::Printing)] {
        assert_eq!(store.job(id).await.unwrap().0.state, state);
    }
    let beds: Vec<_> = store.printers().await.unwrap().into_iter().map(|p| (p.bed, p.is_doubted)).collect();
    assert_eq!(beds, [(Bed::Unknown, true), (Bed::Taken(laid.job.id), true), (Bed::Unknown, true)]);
    store.verify().await.unwrap();
    store.close().await;
}

#[tokio::test]
async fn cases_are_found_again_where_they_lie() {
    let root = tempfile::tempdir().unwrap();
    let (dir, file, new) = (root.path().join("state"), root.path().join("b.zip"), root.path().join("new"));
    state(&dir).await.close().await;
    symlink("/srv/cases/one", dir.join("files/one.case")).unwrap();
    backup(&dir, &file, at(10)).unwrap();
    restore(&file, &new, at(20)).await.unwrap();
    assert_eq!(std::fs::read_link(new.join("files/one.case")).unwrap(), Path::new("/srv/cases/one"));
}

#[tokio::test]
async fn cases_begun_over_the_api_come_back_with_where_their_ct_lies() {
    let root = tempfile::tempdir().unwrap();
    let (dir, file, new) = (root.path().join("state"), root.path().join("b.zip"), root.path().join("new"));
    state(&dir).await.close().await;
    let names = ["cases/one/case.toml", "cases/one/report/index.html", "sources/one.toml"];
    for name in names {
        std::fs::create_dir_all(dir.join(name).parent().unwrap()).unwrap();
        std::fs::write(dir.join(name), name).unwrap();
    }
    symlink(dir.join("cases/one"), dir.join("files/one.case")).unwrap();
    backup(&dir, &file, at(10)).unwrap();
    restore(&file, &new, at(20)).await.unwrap();
    std::fs::remove_dir_all(&dir).unwrap();
    for name in names {
        assert_eq!(std::fs::read_to_string(new.join(name)).unwrap(), name);
    }
    // A job of it finds it, wherever the directory lies now.
    assert_eq!(std::fs::read_link(new.join("files/one.case")).unwrap(), new.join("cases/one"));
}

#[tokio::test]
async fn a_backup_links_nothing_but_cases() {
    let root = tempfile::tempdir().unwrap();
    let (dir, file, new) = (root.path().join("state"), root.path().join("b.zip"), root.path().join("new"));
    state(&dir).await.close().await;
    for name in ["jobs/a.case", "files/../a.case", "files/a.gcode", "../a.case"] {
        let mut archive = Archive::new(NamedTempFile::new_in(root.path()).unwrap());
        archive.add(QUEUE, &dir.join(QUEUE)).unwrap();
        let link = CaseLink { name: name.to_owned(), leads_to: "/etc".to_owned() };
        archive.end(vec![link], at(0), &file).unwrap();
        let refused = restore(&file, &new, at(0)).await.unwrap_err().to_string();
        assert!(refused.contains("is no name of a case"), "{refused}");
        assert!(!new.exists());
    }
}

#[tokio::test]
async fn a_backup_of_the_first_format_is_read() {
    let root = tempfile::tempdir().unwrap();
    let (dir, file, new) = (root.path().join("state"), root.path().join("b.zip"), root.path().join("new"));
    state(&dir).await.close().await;
    let mut archive = Archive::new(NamedTempFile::new_in(root.path()).unwrap());
    archive.add(QUEUE, &dir.join(QUEUE)).unwrap();
    let Archive { mut zip, entries } = archive;
    zip.start_file(MANIFEST, Archive::options()).unwrap();
    let manifest =
        serde_json::json!({ "format": 1, "made_by": "lumenfab 0.1.0", "made_at": at(0), "entries": entries });
    serde_json::to_writer(&mut zip, &manifest).unwrap();
    zip.finish().unwrap().persist(&file).unwrap();
    assert_eq!(restore(&file, &new, at(20)).await.unwrap().n_held, 2);
}
