//! Nothing that identifies a patient leaves the CT: planted identifiers are looked for in everything that is written or said.
//!
//! Every identifying attribute of a small series, its private attributes, its folder and its files carry a word or a number of
//! their own. Then the program is used as it is meant to be, and wrongly, with all logging on. The rule: attribute values
//! occur nowhere; paths of the CT occur in the one line that tells the operator which file is at fault, on stderr, and in the
//! private file that remembers where the CT of a case lies; never in results, JSON documents, cases, logs or G-code.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

use dicom_core::value::{DataSetSequence, PrimitiveValue};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::tags;
use dicom_object::{DefaultDicomObject, InMemDicomObject, open_file};
use lumenfab::phantom::{self, Kind, Params};
use lumenfab::progress::Task;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Texts of attributes that name or describe a patient, a visit, a place or a person; retired ones by their numbers (other ids,
/// place of the record, ethnic group).
const TEXTS: [(Tag, VR); 40] = [
    (tags::PATIENT_NAME, VR::PN),
    (tags::PATIENT_ID, VR::LO),
    (tags::ISSUER_OF_PATIENT_ID, VR::LO),
    (Tag(0x0010, 0x1000), VR::LO),
    (tags::OTHER_PATIENT_NAMES, VR::PN),
    (tags::PATIENT_BIRTH_NAME, VR::PN),
    (tags::PATIENT_MOTHER_BIRTH_NAME, VR::PN),
    (tags::PATIENT_ADDRESS, VR::LO),
    (tags::PATIENT_TELEPHONE_NUMBERS, VR::SH),
    (tags::PATIENT_COMMENTS, VR::LT),
    (tags::ADDITIONAL_PATIENT_HISTORY, VR::LT),
    (Tag(0x0010, 0x1090), VR::LO),
    (tags::MILITARY_RANK, VR::LO),
    (tags::OCCUPATION, VR::SH),
    (Tag(0x0010, 0x2160), VR::SH),
    (tags::ACCESSION_NUMBER, VR::SH),
    (tags::ADMISSION_ID, VR::LO),
    (tags::STUDY_ID, VR::SH),
    (tags::STUDY_DESCRIPTION, VR::LO),
    (tags::SERIES_DESCRIPTION, VR::LO),
    (tags::PROTOCOL_NAME, VR::LO),
    (tags::IMAGE_COMMENTS, VR::LT),
    (tags::INSTITUTION_NAME, VR::LO),
    (tags::INSTITUTION_ADDRESS, VR::ST),
    (tags::INSTITUTIONAL_DEPARTMENT_NAME, VR::LO),
    (tags::STATION_NAME, VR::SH),
    (tags::DEVICE_SERIAL_NUMBER, VR::LO),
    (tags::MANUFACTURER, VR::LO),
    (tags::MANUFACTURER_MODEL_NAME, VR::LO),
    (tags::SOFTWARE_VERSIONS, VR::LO),
    (tags::REFERRING_PHYSICIAN_NAME, VR::PN),
    (tags::PERFORMING_PHYSICIAN_NAME, VR::PN),
    (tags::REQUESTING_PHYSICIAN, VR::PN),
    (tags::NAME_OF_PHYSICIANS_READING_STUDY, VR::PN),
    (tags::OPERATORS_NAME, VR::PN),
    (tags::REQUESTED_PROCEDURE_DESCRIPTION, VR::LO),
    (tags::PERFORMED_PROCEDURE_STEP_ID, VR::SH),
    (tags::CURRENT_PATIENT_LOCATION, VR::LO),
    (tags::CONVOLUTION_KERNEL, VR::SH),
    (tags::RESCALE_TYPE, VR::LO),
];
/// Dates and times, each another one.
const TIMES: [(Tag, VR, &str); 8] = [
    (tags::PATIENT_BIRTH_DATE, VR::DA, "19330717"),
    (tags::STUDY_DATE, VR::DA, "20310411"),
    (tags::SERIES_DATE, VR::DA, "20310412"),
    (tags::ACQUISITION_DATE, VR::DA, "20310413"),
    (tags::CONTENT_DATE, VR::DA, "20310414"),
    (tags::STUDY_TIME, VR::TM, "135741.771"),
    (tags::ACQUISITION_TIME, VR::TM, "135742.772"),
    (tags::PATIENT_BIRTH_TIME, VR::TM, "035743.773"),
];
/// Unique identifiers; that of the image is another one in each file.
const UIDS: [(Tag, &str); 4] = [
    (tags::STUDY_INSTANCE_UID, "1.2.826.0.1.77001"),
    (tags::SERIES_INSTANCE_UID, SERIES_UID),
    (tags::SOP_INSTANCE_UID, "1.2.826.0.1.77003"),
    (tags::FRAME_OF_REFERENCE_UID, "1.2.826.0.1.77004"),
];
const SERIES_UID: &str = "1.2.826.0.1.77002";
/// What every planted word begins with.
const WORD: &str = "ZQX";
const FOLDER: &str = "ZQXFOLDER^JANE (1933)";

/// What may occur nowhere, whatever it stands in.
fn secrets() -> Vec<String> {
    let times = TIMES.iter().map(|t| t.2.split('.').next().unwrap_or_default().to_owned());
    let uids = ["1.2.826.0.1.7700".to_owned()];
    times.chain(uids).chain([WORD.to_owned()]).collect()
}

fn plant(object: &mut DefaultDicomObject, number: usize) {
    let mut put = |tag: Tag, vr: VR, text: &str| {
        object.put(DataElement::new(tag, vr, PrimitiveValue::from(text)));
    };
    for (i, (tag, vr)) in TEXTS.into_iter().enumerate() {
        put(tag, vr, &format!("{WORD}{i}^JANE"));
    }
    TIMES.iter().for_each(|&(tag, vr, text)| put(tag, vr, text));
    UIDS.iter().for_each(|&(tag, text)| put(tag, VR::UI, text));
    put(tags::SOP_INSTANCE_UID, VR::UI, &format!("1.2.826.0.1.77003.{number}"));
    put(Tag(0x0009, 0x0010), VR::LO, "ZQXPRIVATE");
    put(Tag(0x0009, 0x1001), VR::LO, "ZQXPRIVATE^JANE");
    put(Tag(0x0029, 0x0010), VR::LO, "ZQXOTHER");
    put(Tag(0x0029, 0x1010), VR::LT, "ZQXOTHER JANE");
    let nested = DataElement::new(tags::PATIENT_ID, VR::LO, PrimitiveValue::from("ZQXNESTED"));
    let item = InMemDicomObject::from_element_iter([nested]);
    object.put(DataElement::new(
        tags::OTHER_PATIENT_I_DS_SEQUENCE,
        VR::SQ,
        DataSetSequence::from(vec![item]),
    ));
    object.update_meta(|m| {
        m.media_storage_sop_instance_uid = format!("1.2.826.0.1.77003.{number}");
        m.source_application_entity_title = Some("ZQXAETITLE".into());
    });
}

/// A place with a planted series, where everything else that turns up was made by the program.
struct Place {
    dir: tempfile::TempDir,
    seed: String,
}

impl Place {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let params =
            Params { kind: Kind::Tube, n_planes: 4, n_pixels: 128, pixel_mm: 0.4, ..Params::default() };
        let seed = phantom::default_seed(&params);
        let place = Self { dir, seed: format!("--seed-mm={},{},{}", seed.x, seed.y, seed.z) };
        phantom::series::write(&place.ct(), &params, &Task::quiet()).unwrap();
        fs::remove_file(place.ct().join("truth.json")).unwrap();
        for number in 1..=4 {
            let file = place.ct().join(format!("IM{number:04}.dcm"));
            let mut object = open_file(&file).unwrap();
            plant(&mut object, number);
            object.write_to_file(place.file(number)).unwrap();
            fs::remove_file(file).unwrap();
        }
        fs::create_dir(place.dir.path().join("tmp")).unwrap();
        place
    }

    fn ct(&self) -> PathBuf {
        self.dir.path().join(FOLDER).join("ZQXSUB")
    }

    fn file(&self, number: usize) -> PathBuf {
        self.ct().join(format!("ZQXFILE_{number}.dcm"))
    }

    fn run(&self, args: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_lumenfab"))
            .args(args)
            .current_dir(self.dir.path())
            .env("XDG_STATE_HOME", self.dir.path().join("state"))
            .env("HOME", self.dir.path().join("home"))
            .env("TMPDIR", self.dir.path().join("tmp"))
            .env("LUMENFAB_LOG", "trace")
            .output()
            .unwrap()
    }

    /// Runs a command, checks its exit code and all it says.
    fn says_nothing(&self, code: i32, args: &[&str]) -> String {
        let output = self.run(args);
        let (out, err) = (text(&output.stdout), text(&output.stderr));
        // Beside the result, the path may stand in the line that names the file at fault; nothing else may.
        let without_paths = |line: &str| {
            let mut line = line.replace(&self.ct().display().to_string(), "").replace(FOLDER, "");
            (1..=4).for_each(|n| line = line.replace(&format!("ZQXFILE_{n}.dcm"), ""));
            line.replace("ZQXSUB", "")
        };
        for line in err.lines() {
            let is_fault = line.starts_with("error: ") || line.starts_with("unusable: ");
            let seen = if is_fault { without_paths(line) } else { line.to_owned() };
            assert_clean(seen.as_bytes(), &format!("stderr of {args:?}"));
        }
        assert_clean(out.as_bytes(), &format!("stdout of {args:?}"));
        assert_eq!(output.status.code(), Some(code), "{args:?}: {err}");
        out + &err
    }

    /// Everything that was written, apart from the CT itself and the private directory.
    fn written(&self) -> Vec<PathBuf> {
        let is_own =
            |p: &PathBuf| !p.starts_with(self.dir.path().join(FOLDER)) && !p.starts_with(self.sources());
        files(self.dir.path()).into_iter().filter(is_own).collect()
    }

    fn sources(&self) -> PathBuf {
        self.dir.path().join("state/lumenfab/sources")
    }

    fn assert_nothing_written(&self) {
        for file in self.written() {
            let name = file.strip_prefix(self.dir.path()).unwrap().display().to_string();
            assert_clean(name.as_bytes(), "a file's name");
            assert_clean(&fs::read(&file).unwrap(), &name);
        }
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn files(dir: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { found.extend(files(&path)) } else { found.push(path) }
    }
    found
}

fn assert_clean(bytes: &[u8], place: &str) {
    for secret in secrets() {
        let wide: Vec<u8> = secret.bytes().flat_map(|b| [b, 0]).collect();
        for needle in [secret.as_bytes(), &wide] {
            let is_there =
                |at: &usize| bytes[*at..].starts_with(needle) && !is_within_a_number(bytes, *at, needle);
            let found = (0..bytes.len()).find(is_there);
            let around = found.map(|at| text(&bytes[at.saturating_sub(60)..(at + 60).min(bytes.len())]));
            assert_eq!(around, None, "{secret} in {place}");
        }
    }
}

/// Whether digits that were found belong to a longer number: coordinates hold any digits by chance.
fn is_within_a_number(bytes: &[u8], at: usize, needle: &[u8]) -> bool {
    let is_digits = needle.iter().all(u8::is_ascii_digit);
    let before = at.checked_sub(1).map(|i| bytes[i]);
    let after = bytes.get(at + needle.len());
    let belongs = |b: u8| b.is_ascii_digit() || b == b'.';
    is_digits && (before.is_some_and(belongs) || after.is_some_and(u8::is_ascii_digit))
}

#[test]
fn the_whole_way_tells_nothing() {
    let place = Place::new();
    let ct = place.ct().display().to_string();
    let shown = place.says_nothing(0, &["inspect", &ct]);
    assert!(shown.contains("usable"), "{shown}");
    place.says_nothing(0, &["inspect", &ct, "--json"]);
    place.says_nothing(0, &["run", "--ct", &ct, &place.seed, "--out", "case"]);
    place.says_nothing(0, &["run", "case", "--json"]);
    place.says_nothing(
        0,
        &[
            "solid",
            "case",
            "--view",
            "view.png",
            "--size-px",
            "200",
            "--from",
            "front",
            "--matching",
            "matching.svg",
        ],
    );
    place.says_nothing(0, &["export", "case", "--stl", "a.stl", "--3mf", "a.3mf", "--step", "a.step"]);
    place.says_nothing(0, &["slice", "case", "--out", "job.gcode"]);
    place.says_nothing(
        0,
        &["segment", "--ct", &ct, "--series", SERIES_UID, &place.seed, "--out", "by-uid", "--json"],
    );
    place.says_nothing(
        1,
        &["segment", "--ct", &ct, &place.seed, "--window-hu=-2000,6000", "--out", "leaking", "--json"],
    );
    assert!(place.dir.path().join("leaking/leak.png").is_file());
    let case = fs::read_to_string(place.dir.path().join("by-uid/case.toml")).unwrap();
    assert!(case.contains("series = 1"), "{case}");
    // A scan of the replica comes from a scanner, too. This one shows a patient: it is refused, and nothing of it is told or kept.
    for further in [None, Some("--json")] {
        let args: Vec<&str> = ["report", "case", "--scan", &ct].into_iter().chain(further).collect();
        let told = place.says_nothing(1, &args);
        assert!(told.contains("scan"), "{told}");
    }
    let n_written = place.written().len();
    assert!(n_written > 20, "cases, report and exports were looked at: {n_written}");
    place.assert_nothing_written();
}

/// A simulated printer on `port` that stops for good in the middle of a print, and ends when its user leaves.
#[expect(clippy::disallowed_methods, reason = "the test waits for another process")]
fn printer_that_stops(place: &Place) -> Child {
    let printer = Command::new(env!("CARGO_BIN_EXE_lumenfab"))
        .args(["hil-sim", "--profile", "marlin", "--speed", "max", "--link", "port", "--once"])
        .args(["--fault", "kill:line=200"])
        .current_dir(place.dir.path())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let start = Instant::now();
    while !place.dir.path().join("port").exists() {
        assert!(start.elapsed() < Duration::from_secs(60), "no printer");
        std::thread::sleep(Duration::from_millis(2));
    }
    printer
}

#[test]
fn what_is_kept_of_a_print_that_broke_off_tells_nothing() {
    let place = Place::new();
    let ct = place.ct().display().to_string();
    place.says_nothing(0, &["segment", "--ct", &ct, &place.seed, "--out", "case"]);
    place.says_nothing(0, &["solid", "case"]);
    place.says_nothing(0, &["slice", "case"]);
    let mut printer = printer_that_stops(&place);
    place.says_nothing(1, &["print", "case", "--port", "port"]);
    printer.wait().unwrap();
    for file in ["job.gcode.journal", "job.gcode.resume.svg"] {
        assert!(place.dir.path().join("case").join(file).is_file(), "{file}");
    }
    place.assert_nothing_written();
}

#[test]
fn where_the_ct_lies_is_known_to_its_owner_alone() {
    let place = Place::new();
    let ct = place.ct().display().to_string();
    place.says_nothing(0, &["segment", "--ct", &ct, &place.seed, "--out", "case"]);
    let known = files(&place.sources());
    assert_eq!(known.len(), 1);
    assert!(fs::read_to_string(&known[0]).unwrap().contains("ZQXFOLDER"));
    let mode = |p: &Path| fs::metadata(p).unwrap().permissions().mode() & 0o777;
    assert_eq!((mode(&known[0]), mode(&place.sources())), (0o600, 0o700));
    // And it is found again without being named.
    place.says_nothing(0, &["segment", "case", "--window-hu", "150,450"]);
    place.assert_nothing_written();
}

#[test]
fn errors_tell_the_operator_where_and_nothing_more() {
    type Damage = fn(&Place);
    let damages: [(&str, Damage); 8] = [
        ("truncated", |p| {
            let bytes = fs::read(p.file(2)).unwrap();
            fs::write(p.file(2), &bytes[..bytes.len() - 500]).unwrap();
        }),
        ("no DICOM", |p| fs::write(p.file(2), "ZQXJUNK").unwrap()),
        ("no position", |p| {
            edit(p, |o| {
                o.remove_element(tags::IMAGE_POSITION_PATIENT);
            })
        }),
        ("a name for a number", |p| {
            edit(p, |o| {
                o.put(DataElement::new(tags::PIXEL_SPACING, VR::DS, PrimitiveValue::from("ZQXA\\ZQXB")));
            });
        }),
        ("a name for an orientation", |p| {
            edit(p, |o| {
                o.put(DataElement::new(tags::IMAGE_ORIENTATION_PATIENT, VR::DS, PrimitiveValue::from("ZQX")));
            });
        }),
        ("a missing plane", |p| fs::remove_file(p.file(2)).unwrap()),
        ("another size", |p| {
            edit(p, |o| {
                o.put(DataElement::new(tags::ROWS, VR::US, PrimitiveValue::from(64_u16)));
            })
        }),
        ("another image at one place", |p| {
            let mut other = open_file(p.file(2)).unwrap();
            other.put(DataElement::new(
                tags::PIXEL_DATA,
                VR::OW,
                PrimitiveValue::U16(vec![7; 128 * 128].into()),
            ));
            other.write_to_file(p.ct().join("ZQXFILE_4.dcm.copy")).unwrap();
        }),
    ];
    for (what, damage) in damages {
        let place = Place::new();
        damage(&place);
        let ct = place.ct().display().to_string();
        let run = ["run", "--ct", &ct, &place.seed, "--out", "case"];
        let said = place.run(&run);
        assert_eq!(said.status.code(), Some(1), "{what}: {}", text(&said.stderr));
        place.says_nothing(1, &run);
        place.says_nothing(1, &[&run[..], &["--json"]].concat());
        let inspected = place.run(&["inspect", &ct, "--json"]);
        assert_clean(&inspected.stdout, what);
        place.assert_nothing_written();
    }
    let place = Place::new();
    let nowhere = format!("{}/ZQXSUB/gone", place.ct().display());
    let ct = place.ct().display().to_string();
    place.says_nothing(2, &["run", "--ct", &nowhere, &place.seed, "--out", "case", "--json"]);
    place.says_nothing(2, &["run", "--ct", &ct, "--series", "1.2.3.4", &place.seed, "--out", "case"]);
    place.says_nothing(2, &["run", "--ct", &ct, "--series", "7", &place.seed, "--out", "case", "--json"]);
    place.says_nothing(2, &["run", "--ct", &ct, "--series", &format!("{SERIES_UID}x"), &place.seed]);
    place.assert_nothing_written();
}

fn edit(place: &Place, change: impl Fn(&mut DefaultDicomObject)) {
    let mut object = open_file(place.file(2)).unwrap();
    change(&mut object);
    object.write_to_file(place.file(2)).unwrap();
}

/// Inputs of the operator's own may be called after a patient: the line of the error on the screen names them, no document does.
#[test]
fn names_of_case_files_and_contours_stay_on_the_screen() {
    let place = Place::new();
    let put = |name: &str, text: &str| {
        let path = place.dir.path().join(FOLDER).join(name);
        fs::write(&path, text).unwrap();
        path.display().to_string()
    };
    let broken = put("ZQXJANE.toml", "ct = 7");
    let contours = put("ZQXJANE.json", "{}");
    let gone = place.dir.path().join(FOLDER).join("ZQXGONE.json").display().to_string();
    let cases: [(i32, &[&str], &str); 3] = [
        (2, &["segment", &broken, "--json"], "the case file: line 1: "),
        (1, &["solid", "--sections", &contours, "--out", "case", "--json"], "the contours: "),
        (1, &["solid", "--sections", &gone, "--out", "case", "--json"], "cannot read the input file: "),
    ];
    for (code, args, start) in cases {
        let said = place.run(args);
        assert_eq!(said.status.code(), Some(code), "{args:?}: {}", text(&said.stderr));
        assert_clean(&said.stdout, &format!("stdout of {args:?}"));
        let document: serde_json::Value = serde_json::from_slice(&said.stdout).unwrap();
        assert!(document["error"].as_str().unwrap().starts_with(start), "{document}");
        assert!(text(&said.stderr).contains("ZQX"), "the operator is told which file");
    }
    place.assert_nothing_written();
}
