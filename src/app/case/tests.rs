use super::*;

fn settings() -> Settings {
    Settings::try_from(CaseFile::default()).unwrap()
}

fn made_from(hash: &str) -> MadeFrom {
    MadeFrom::from([("ct", hash.to_owned()), ("parameters", "p".into())])
}

fn do_stage(case: &mut Case, hash: &str, files: &[(&str, &str)]) {
    let staging = case.staging().unwrap();
    for (name, text) in files {
        staging.write(name, text.as_bytes()).unwrap();
    }
    case.commit(Stage::Segment, &made_from(hash), staging, Told::default()).unwrap();
}

fn new_case(dir: &Path) -> Case {
    Case::create(dir, "id-1".into(), settings()).unwrap()
}

#[test]
fn a_new_case_comes_into_being_with_its_first_stage() {
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("deep/case");
    let mut case = new_case(&dir);
    assert!(!root.path().join("deep").exists());
    do_stage(&mut case, "1", &[("sections.json", "{}")]);
    assert_eq!(case.outdated(Stage::Segment, &made_from("1")).unwrap(), None);
    drop(case);
    let case = Case::open(&dir).unwrap();
    assert_eq!((case.id(), case.settings()), ("id-1", &settings()));
    assert_eq!(case.outdated(Stage::Segment, &made_from("1")).unwrap(), None);
    let names: Vec<_> = fs::read_dir(&dir).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names.len(), 4, "{names:?}");
    assert_eq!(atomic::entries(&root.path().join("deep")).unwrap(), [dir]);
}

#[test]
fn a_first_stage_that_fails_leaves_nothing_behind() {
    let root = tempfile::tempdir().unwrap();
    let case = new_case(&root.path().join("deep/down/case"));
    let staging = case.staging().unwrap();
    staging.write("sections.json", b"{").unwrap();
    drop(staging);
    drop(case);
    assert!(atomic::entries(root.path()).unwrap().is_empty());
}

#[test]
fn a_stage_is_outdated_when_what_it_was_made_from_or_what_it_made_changes() {
    let root = tempfile::tempdir().unwrap();
    let mut case = new_case(&root.path().join("case"));
    assert_eq!(case.outdated(Stage::Segment, &made_from("1")).unwrap(), Some(vec![]));
    do_stage(&mut case, "1", &[("sections.json", "{}"), ("volume.bin", "v")]);
    assert_eq!(case.outdated(Stage::Segment, &made_from("2")).unwrap(), Some(vec!["ct".into()]));
    fs::remove_file(case.path("volume.bin")).unwrap();
    let reasons = case.outdated(Stage::Segment, &made_from("1")).unwrap().unwrap();
    assert_eq!(reasons, ["volume.bin"]);
}

#[test]
fn what_a_stage_told_is_known_to_whoever_opens_the_case_later() {
    let place = tempfile::tempdir().unwrap();
    let mut case = new_case(&place.path().join("case"));
    let told = Told {
        summary: "46 planes".into(),
        warnings: vec![Warning::new("segment.followed", "it ends at \"z 84\"")],
    };
    let staging = case.staging().unwrap();
    staging.write("sections.json", b"{}").unwrap();
    case.commit(Stage::Segment, &made_from("a"), staging, told.clone()).unwrap();
    drop(case);
    let case = Case::open(&place.path().join("case")).unwrap();
    assert_eq!((case.told(Stage::Segment), case.told(Stage::Solid)), (told, Told::default()));
}

#[test]
fn a_result_that_was_changed_by_hand_is_not_made_again() {
    let root = tempfile::tempdir().unwrap();
    let mut case = new_case(&root.path().join("case"));
    do_stage(&mut case, "1", &[("sections.json", "{}"), ("volume.bin", "v")]);
    fs::write(case.path("sections.json"), "{ }").unwrap();
    let message = case.outdated(Stage::Segment, &made_from("2")).unwrap_err().to_string();
    assert!(message.contains("/case/sections.json was changed by hand"), "{message}");
    assert!(message.contains("run `lumenfab solid --sections /"), "{message}");
}

#[test]
fn parameters_are_written_down_when_a_stage_had_use_for_them() {
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("case");
    do_stage(&mut new_case(&dir), "1", &[("a", "1")]);
    let other = Settings { port: "/dev/ttyUSB0".into(), ..settings() };
    let mut case = Case::open(&dir).unwrap();
    case.set_settings(other.clone());
    drop(case);
    let mut case = Case::open(&dir).unwrap();
    assert_eq!(case.settings(), &settings());
    case.set_settings(other.clone());
    case.keep_settings().unwrap();
    drop(case);
    assert_eq!(Case::open(&dir).unwrap().settings(), &other);
}

#[test]
fn drafts_of_killed_processes_are_swept_and_those_of_others_stay() {
    let root = tempfile::tempdir().unwrap();
    let killed = root.path().join(".lumenfab-killed");
    fs::create_dir(&killed).unwrap();
    fs::write(killed.join(draft::LOCK_FILE), "").unwrap();
    let working = new_case(&root.path().join("one"));
    let staging = working.staging().unwrap();
    drop(new_case(&root.path().join("two")));
    assert!(staging.path().exists() && !killed.exists());
}

#[test]
fn what_a_stage_made_is_replaced_and_what_it_no_longer_makes_is_removed() {
    let root = tempfile::tempdir().unwrap();
    let mut case = new_case(&root.path().join("case"));
    do_stage(&mut case, "1", &[("a", "1"), ("b", "1")]);
    for text in ["1", "2"] {
        let staging = case.staging().unwrap();
        fs::create_dir(staging.path().join("record")).unwrap();
        fs::write(staging.path().join("record/x"), text).unwrap();
        case.commit(Stage::Segment, &made_from(text), staging, Told::default()).unwrap();
        assert_eq!(atomic::read_text(&case.path("record/x")).unwrap(), text);
    }
    assert!(!case.path("a").exists() && !case.path("b").exists());
}

#[test]
fn other_directories_are_left_alone() {
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("thesis");
    fs::create_dir(&dir).unwrap();
    assert!(matches!(Case::open(&dir), Err(CaseError::Missing(_))));
    fs::write(dir.join("chapter1.tex"), "").unwrap();
    assert!(matches!(Case::open(&dir), Err(CaseError::NotACase(_))));
    assert!(matches!(Case::create(&dir, "i".into(), settings()), Err(CaseError::Occupied(_))));
    let file = dir.join("chapter1.tex");
    assert!(matches!(Case::create(&file, "i".into(), settings()), Err(CaseError::Occupied(_))));
}

#[test]
fn two_processes_do_not_work_on_one_case_and_leftovers_are_swept() {
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("case");
    let mut case = new_case(&dir);
    do_stage(&mut case, "1", &[("a", "1")]);
    assert!(matches!(Case::open(&dir), Err(CaseError::InUse(_))));
    drop(case);
    fs::create_dir(dir.join(".lumenfab-killed")).unwrap();
    Case::open(&dir).unwrap();
    assert!(!dir.join(".lumenfab-killed").exists());
}

#[test]
fn a_damaged_case_file_is_named_with_its_line() {
    let root = tempfile::tempdir().unwrap();
    fs::write(root.path().join(CASE_FILE), "format = 1\nwall = 3\n").unwrap();
    let message = Case::open(root.path()).unwrap_err().to_string();
    assert!(message.contains("case.toml: line 2: unknown field `wall`"), "{message}");
}

#[test]
fn a_missing_output_says_which_stage_to_run() {
    let root = tempfile::tempdir().unwrap();
    let mut case = new_case(&root.path().join("case"));
    do_stage(&mut case, "1", &[("a", "1")]);
    let message = case.output(Stage::Slice, "job.gcode").unwrap_err().to_string();
    assert!(message.contains("has no job.gcode yet: run `lumenfab slice "), "{message}");
}
