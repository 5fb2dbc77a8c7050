use super::*;
use crate::printer::control::Controls;
use crate::printer::journal::{Ending, Progress, Track};

const NAME: &str = "ZQX-Doe-Jane.gcode";

struct Place {
    dir: tempfile::TempDir,
    profile: Profile,
    controls: Controls,
}

impl Place {
    fn new() -> Self {
        let place = Self {
            dir: tempfile::tempdir().unwrap(),
            profile: profile::builtin("marlin").unwrap(),
            controls: Controls::default(),
        };
        std::fs::write(place.job(), "G28\nG90\nM83\nG1 X10 Y10 Z0.2 F600\nG1 X20 E1\nG1 X30 E1\n").unwrap();
        place
    }

    fn job(&self) -> PathBuf {
        self.dir.path().join(NAME)
    }

    fn with_paper<T>(&self, see: impl FnOnce(&Paper<'_>) -> T) -> T {
        see(&Paper {
            job: &self.job(),
            profile: &self.profile,
            profile_name: "marlin",
            port: "/dev/nonexistent-port",
            baud: None,
            controls: &self.controls,
        })
    }

    /// The journal of a print that came so far.
    fn journal(&self, n_sent: u64, end: Option<Ending>) {
        let records = self.with_paper(|paper| {
            let machine = Machine {
                profile: "marlin".into(),
                profile_hash: String::new(),
                port: paper.port.into(),
                device: None,
            };
            [Record::Job(paper.job_id(&paper.open_job().unwrap()).unwrap()), Record::Machine(machine)]
        });
        let journal = Journal::create(&path_for(&self.job()), &records).unwrap();
        let progress = Progress { n_sent, n_acked: n_sent, n_certain: n_sent / 2, ..Progress::default() };
        let rest = [Record::Session(Track::default()), Record::Progress(progress)];
        for record in rest.into_iter().chain(end.map(Record::End)) {
            assert!(journal.append(&record));
            journal.flush();
        }
    }
}

#[test]
fn a_print_that_broke_off_is_not_begun_again_by_accident() {
    let place = Place::new();
    let refused = || place.with_paper(|paper| paper.refuse_unfinished(false));
    assert!(refused().is_ok(), "nothing is known of a print");
    place.journal(0, None);
    assert!(refused().is_ok(), "nothing was sent");
    for end in [Ending::Finished, Ending::Cancelled] {
        place.journal(6, Some(end));
        assert!(refused().is_ok());
    }
    for end in [None, Some(Ending::Faulted("printer.halted".into()))] {
        place.journal(5, end);
        let error = refused().unwrap_err();
        assert_eq!(error.code(), "printer.unfinished");
        let text = error.to_string();
        assert!(text.contains("broke off behind line 2 of 6") && text.contains("--anew"), "{text}");
        assert!(text.contains("lumenfab resume"), "{text}");
    }
}

#[test]
fn a_job_that_has_changed_is_not_sent_back_to_resume() {
    let place = Place::new();
    place.journal(5, None);
    std::fs::write(place.job(), "G28\nG1 X1\n").unwrap();
    let error = place.with_paper(|paper| paper.refuse_unfinished(false)).unwrap_err();
    assert_eq!(error.code(), "printer.other_job");
    assert!(error.to_string().contains("--anew"), "{error}");
}

#[test]
fn a_journal_that_cannot_be_read_is_none_only_with_consent_and_something_else_never() {
    let place = Place::new();
    let refused =
        |anew| place.with_paper(|paper| paper.refuse_unfinished(anew)).map_err(|error| error.code());
    std::fs::write(path_for(&place.job()), "lumenfab print journal 1\n{}\n").unwrap();
    assert_eq!((refused(false), refused(true)), (Err("printer.journal_version"), Ok(())));
    std::fs::write(path_for(&place.job()), "my notes on the print\n").unwrap();
    assert_eq!(
        (refused(false), refused(true)),
        (Err("printer.journal_foreign"), Err("printer.journal_foreign"))
    );
}

#[test]
fn a_job_is_printed_by_one_process_at_a_time() {
    let place = Place::new();
    let locked = |paper: &Paper<'_>| lock(paper.job);
    let first = place.with_paper(locked).unwrap();
    let second = place.with_paper(locked).unwrap_err();
    assert_eq!(second.code(), "printer.being_printed");
    drop(first);
    assert!(place.with_paper(locked).is_ok());
}

#[test]
fn where_no_printer_answers_the_last_journal_is_put_back() {
    let place = Place::new();
    for has_begun in [false, true] {
        place.journal(5, None);
        let journal = path_for(&place.job());
        let before = std::fs::read(&journal).unwrap();
        let aside = Aside::of(journal.clone()).unwrap();
        assert!(!journal.exists());
        std::fs::write(&journal, "another").unwrap();
        aside.settle(has_begun);
        let expected = if has_begun { b"another".to_vec() } else { before };
        assert_eq!(std::fs::read(&journal).unwrap(), expected);
        assert_eq!(
            std::fs::read_dir(journal.parent().unwrap())
                .unwrap()
                .flatten()
                .filter(|e| e.path().extension().is_some_and(|e| e == "before"))
                .count(),
            0
        );
    }
}

#[test]
fn journal_and_picture_name_neither_the_job_s_file_nor_a_path() {
    let place = Place::new();
    place.journal(5, None);
    place.with_paper(|paper| paper.draw_last());
    let files = [path_for(&place.job()), picture_path(&place.job())];
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(!text.contains("ZQX"), "{text}");
        assert!(!text.contains(&*place.dir.path().to_string_lossy()), "{text}");
        use std::os::unix::fs::PermissionsExt;
        assert_eq!(std::fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
    }
}

#[test]
fn the_session_knows_the_rate_of_the_wire() {
    let place = Place::new();
    place.with_paper(|paper| {
        let paper = Paper { baud: Some(1_000_000), ..*paper };
        assert_eq!(paper.profile_at_rate().firmware.baud, 1_000_000);
        let paper = Paper { baud: None, ..paper };
        assert_eq!(paper.profile_at_rate(), *paper.profile);
    });
}

#[test]
fn of_a_profile_s_path_its_name_is_kept() {
    assert_eq!(without_folders("/home/zqx/profiles/mine.toml"), "mine.toml");
    assert_eq!(without_folders("marlin"), "marlin");
}

#[test]
fn of_a_port_s_path_a_device_or_its_name_is_kept() {
    assert_eq!(port_kept("/home/zqx/port"), "port");
    assert_eq!(port_kept("/dev/serial/by-id/usb-X"), "/dev/serial/by-id/usb-X");
    assert_eq!(port_kept("usb:1a86:7523"), "usb:1a86:7523");
}

#[test]
fn another_printer_or_profile_is_refused_by_name() {
    let machine = |profile: &str, hash: &str, device: Option<&str>| Machine {
        profile: profile.into(),
        profile_hash: hash.into(),
        port: "/dev/ttyUSB0".into(),
        device: device.map(Into::into),
    };
    let before = machine("marlin", "1", Some("usb:1:2:A"));
    for same in [before.clone(), machine("marlin", "1", None)] {
        assert!(check_machine(&same, &before).is_ok());
    }
    for (other, word) in [
        (machine("marlin", "1", Some("usb:1:2:B")), "usb:1:2:B"),
        (machine("klipper", "2", Some("usb:1:2:A")), "began with the profile marlin"),
        (machine("marlin", "2", Some("usb:1:2:A")), "has changed since"),
    ] {
        let error = check_machine(&other, &before).unwrap_err();
        assert_eq!(error.code(), "printer.other_machine");
        assert!(error.to_string().contains(word), "{error}");
    }
}

#[test]
fn a_profile_s_file_is_found_again_beside_the_job() {
    let place = Place::new();
    place.journal(5, None);
    let log = log_of(&place.job()).unwrap();
    assert_eq!(profile_of(&place.job(), &log), "marlin");
    let own = place.dir.path().join("marlin");
    std::fs::write(&own, "").unwrap();
    assert_eq!(profile_of(&place.job(), &log), own.display().to_string());
}

#[test]
fn the_time_since_a_print_broke_off_is_that_of_its_journal() {
    let place = Place::new();
    assert!(away_s(&place.job()).is_infinite(), "nobody knows");
    place.journal(5, None);
    assert!(away_s(&place.job()) < 60.0);
    // The clock has not been set yet since the board started.
    let journal = File::options().append(true).open(path_for(&place.job())).unwrap();
    let written = journal.metadata().unwrap().modified().unwrap();
    journal.set_modified(written + std::time::Duration::from_secs(86400)).unwrap();
    assert!(away_s(&place.job()).is_infinite());
}
