use super::*;

pub(super) fn first_records() -> Vec<Record> {
    vec![
        Record::Job(JobId { hash: "ab".into(), n_lines: 100 }),
        Record::Machine(Machine {
            profile: "marlin".into(),
            profile_hash: "cd".into(),
            port: "/dev/ttyUSB0".into(),
            device: None,
        }),
        Record::Session(Track {
            first_number: 1,
            prelude: vec!["M155 S2".into()],
            n_before: 0,
            n_twice: 0,
            ..Track::default()
        }),
    ]
}

pub(super) fn begun() -> Vec<u8> {
    let mut bytes = header();
    first_records().iter().for_each(|record| bytes.extend(encode(record)));
    bytes
}

fn with_progress(n: u64) -> Vec<u8> {
    let mut bytes = begun();
    for n_acked in 1..=n {
        bytes.extend(encode(&Record::Progress(Progress {
            n_acked,
            number: n_acked + 1,
            ..Progress::default()
        })));
    }
    bytes
}

fn parse(bytes: &[u8]) -> Result<Log, Error> {
    Log::parse(bytes, Path::new("x.journal"))
}

#[test]
fn what_was_written_is_read() {
    let log = parse(&with_progress(9)).unwrap();
    assert_eq!((log.job.n_lines, log.progress.n_acked, log.n_damaged), (100, 9, 0));
    assert_eq!((log.machine.profile.as_str(), &log.end), ("marlin", &None));
    let mut bytes = with_progress(3);
    bytes.extend(encode(&Record::End(Ending::Faulted("printer.halted".into()))));
    assert_eq!(parse(&bytes).unwrap().end, Some(Ending::Faulted("printer.halted".into())));
}

#[test]
fn a_journal_torn_anywhere_reads_as_far_as_it_goes() {
    let whole = with_progress(5);
    let mut n_last = 0;
    for end in 0..=whole.len() {
        match parse(&whole[..end]) {
            Ok(log) => {
                assert!(log.progress.n_acked >= n_last && log.n_damaged <= 1, "{end}");
                n_last = log.progress.n_acked;
            }
            Err(error) => assert!(matches!(error, Error::NotBegun(_)) && n_last == 0, "{end}: {error}"),
        }
    }
    assert_eq!(n_last, 5);
}

#[test]
fn other_files_and_other_versions_are_told_apart() {
    assert!(matches!(parse(b"G28\nG1 X1\n"), Err(Error::Foreign(_))));
    assert!(matches!(parse(&[0xff; 300]), Err(Error::Foreign(_))));
    let error = parse(b"lumenfab print journal 1\n").unwrap_err();
    assert!(error.to_string().contains("found the format \"lumenfab print journal 1\""), "{error}");
    let missing = Log::read(Path::new("/nonexistent/j.journal")).unwrap_err();
    assert_eq!(missing.code(), "printer.journal_missing");
}

#[test]
fn numbers_on_the_wire_lead_back_to_lines_of_the_job() {
    let track = Track {
        first_number: 11,
        prelude: vec!["M155 S2".into(), "M85 S9".into()],
        n_before: 40,
        n_twice: 0,
        ..Track::default()
    };
    assert_eq!(track.place(9), None);
    assert_eq!(track.place(10), Some(Place::Prelude(0)));
    assert_eq!(track.place(11), Some(Place::Prelude(1)));
    assert_eq!(track.place(12), Some(Place::Job(40)));
    assert_eq!(track.place(15), Some(Place::Job(43)));
    assert_eq!(track.n_job_lines(5), 40);
}

proptest::proptest! {
    #[test]
    fn a_damaged_byte_costs_its_record_and_its_line_feed_the_next_one(at in 0..4000_usize, flip in 1..=255_u8) {
        let mut bytes = with_progress(20);
        let at = HEADER.len() + 1 + at % (bytes.len() - HEADER.len() - 1);
        bytes[at] ^= flip;
        match parse(&bytes) {
            // A line feed: it and the next one.
            Ok(log) => proptest::prop_assert!(log.n_damaged <= 2 && log.progress.n_acked >= 18),
            // One of the first three.
            Err(error) => proptest::prop_assert!(matches!(error, Error::NotBegun(_))),
        }
    }

    #[test]
    fn any_bytes_are_a_journal_or_an_error(bytes in proptest::collection::vec(0_u8.., 0..300)) {
        parse(&bytes).ok();
        let mut behind = begun();
        behind.extend(bytes);
        proptest::prop_assert!(parse(&behind).is_ok());
    }
}
