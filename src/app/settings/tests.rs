use super::*;

fn settings(text: &str) -> Result<Settings, String> {
    Settings::try_from(CaseFile::from_toml(text)?).map_err(|e| e.to_string())
}

#[test]
fn an_empty_file_is_the_phantom_with_all_defaults() {
    let s = settings("").unwrap();
    assert_eq!(s.source, Source::Phantom(phantom::Params::default()));
    assert_eq!(s.body, Body::WallMm(1.0));
    assert_eq!((s.layer_mm, s.profile.as_str(), s.port.as_str()), (0.2, "marlin", "sim"));
}

#[test]
fn a_case_directorys_copy_reads_back_and_holds_no_source_path() {
    let text =
        "ct = \"/data/jane-doe\"\nseed_mm = [[-221.4, 22.5, 165]]\nwindow_hu = [250, 650]\ncast = true";
    let s = settings(text).unwrap();
    let copy = CaseFile::of_case("some-id", &s).to_toml();
    assert!(!copy.contains("jane"), "{copy}");
    assert_eq!(settings(&copy).unwrap(), s);
    let phantom = settings("wall_mm = 2\n[phantom]\nkind = \"stenosis\"\n").unwrap();
    assert_eq!(settings(&CaseFile::of_case("i", &phantom).to_toml()).unwrap(), phantom);
}

#[test]
fn decisions_about_the_topology_are_kept_as_they_were_written() {
    let text = "[solid]\ncorrespondence = \"published\"\n[[topology.link]]\nplane = 12\nlower = 0\nupper = [31.5, -4.0]\njoin = false\n\
                [[topology.drop]]\nplane = 3\ncontour = 2\n";
    let s = settings(text).unwrap();
    assert_eq!(s.correspondence, Correspondence::Published);
    assert_eq!((s.decisions.link.len(), s.decisions.drop.len()), (1, 1));
    assert_eq!(settings(&CaseFile::of_case("i", &s).to_toml()).unwrap(), s);
    let wrong = settings("[[topology.drop]]\nplane = 3\ncontour = \"all\"\n").unwrap_err();
    assert!(wrong.starts_with("line 3: expected the number of a contour, or a point"), "{wrong}");
    let unknown = settings("[[topology.link]]\nplan = 3\n").unwrap_err();
    assert!(unknown.contains("unknown field `plan`"), "{unknown}");
}

#[test]
fn each_bad_value_is_named_with_what_was_found_and_expected() {
    for (text, message) in [
        ("wall_mm = 0", "wall_mm: found 0, expected a number from 0.1 to 20 mm"),
        ("wall_mm = nan", "wall_mm: found NaN, expected a number from 0.1 to 20 mm"),
        ("layer_mm = -0.2", "layer_mm: found -0.2, expected a number from 0.02 to 1 mm"),
        ("wall_mm = 1\ncast = true", "wall_mm: found 1, expected none together with cast"),
        (
            "ct = \"d\"\nseed_mm = [[1, 2, 3]]\nwindow_hu = [300, 200]",
            "window_hu: found 300,200, expected LO,HI: two numbers in HU separated by a comma, LO less than HI",
        ),
        (
            "ct = \"d\"\nseed_mm = [[1, 2, 3]]\nz_mm = [5, 5]",
            "z_mm: found 5,5, expected A,B: two heights in mm separated by a comma, A less than B",
        ),
        (
            "ct = \"d\"",
            "seed_mm: found none, expected X,Y,Z: three numbers in mm (LPS) separated by commas; or auto",
        ),
        (
            "ct = \"d\"\nseed_mm = [[1, inf, 2]]",
            "seed_mm: found 1,inf,2, expected X,Y,Z: three numbers in mm (LPS) separated by commas; or auto",
        ),
        ("profile = \"\"", "profile: found \"\", expected a name or a path"),
        (
            "[phantom]\nnoise_hu = -1",
            "phantom: found phantom parameter noise_hu is -1: choose a value from 0 to 500, expected a phantom within its ranges",
        ),
        ("window_hu = [200, 300]", "ct: found none beside window_hu, expected the CT that it is said of"),
        ("ct = \"d\"\n[phantom]", "phantom: found a CT and a phantom, expected one of the two"),
        ("format = 9", "format is 9, expected 1: written by another version of lumenfab"),
    ] {
        assert_eq!(settings(text).unwrap_err(), message, "{text}");
    }
    let unknown = settings("\nwall = 1").unwrap_err();
    assert!(unknown.starts_with("line 2: unknown field `wall`"), "{unknown}");
}

#[test]
fn texts_of_flags_are_checked_the_same_way() {
    assert_eq!(parse_seed_mm("-221.4, 22.5,165").unwrap(), Seed::Point([-221.4, 22.5, 165.0]));
    for bad in ["1,2", "1,2,3,4", "1,2,x", "1,2,nan", ""] {
        assert!(parse_seed_mm(bad).is_err(), "{bad}");
    }
    assert!(parse_window_hu("650,250").is_err() && parse_z_mm("nan,2").is_err());
    assert!(WALL_MM.parse("1.5").is_ok() && WALL_MM.parse("1.5mm").is_err() && WALL_MM.parse("inf").is_err());
}

#[test]
fn a_series_is_named_by_its_number_or_its_uid() {
    assert_eq!(parse_series(" 2 ").unwrap(), SeriesKey::Number(2));
    assert_eq!(parse_series("1.2.840.1").unwrap(), SeriesKey::Uid("1.2.840.1".into()));
    for bad in ["0", "-1", "1..2", "1.2.x", "1.2.", "two", ""] {
        assert!(parse_series(bad).is_err(), "{bad}");
    }
    // Neither a fault nor a log repeats what may be a patient's.
    assert!(!parse_series("1.2.840.7x").unwrap_err().to_string().contains("840"));
    assert!(!format!("{:?}", parse_series("1.2.840.7")).contains("840"));
    let unresolved = settings("ct = \"d\"\nseed_mm = [[1, 2, 3]]\nseries = \"1.2.840.7\"").unwrap_err();
    assert_eq!(unresolved, "series: found a UID, expected a CT in whose folder it can be looked up");
    let s = settings("ct = \"d\"\nseed_mm = [[1, 2, 3]]\nseries = 2").unwrap();
    assert_eq!(settings(&CaseFile::of_case("i", &s).to_toml()).unwrap(), s);
}

#[test]
fn seeds_are_points_or_the_word_auto() {
    let auto = settings("ct = \"d\"\nseed_mm = \"auto\"\n").unwrap();
    assert!(auto.segment.auto_seed && auto.segment.seed_mm.is_empty());
    let copy = CaseFile::of_case("i", &auto).to_toml();
    assert!(copy.contains("seed_mm = \"auto\""), "{copy}");
    assert_eq!(settings(&copy).unwrap(), auto);
    assert_eq!(parse_seed_mm(" auto").unwrap(), Seed::Auto);
    let wrong = settings("ct = \"d\"\nseed_mm = \"best\"\n").unwrap_err();
    assert!(wrong.starts_with("line 2: expected [[X, Y, Z], ...]"), "{wrong}");
    let both = Seeds(vec![Seed::Auto, Seed::Point([1.0, 2.0, 3.0])]);
    let file = CaseFile { ct: Some("d".into()), seed_mm: Some(both), ..CaseFile::default() };
    let refused = Settings::try_from(file).unwrap_err().to_string();
    assert!(refused.starts_with("seed_mm: found auto and points, expected X,Y,Z"), "{refused}");
}

#[test]
fn what_is_done_about_a_leak_is_kept_and_goes_with_given_seeds_only() {
    let cut = settings("ct = \"d\"\nseed_mm = [[1, 2, 3]]\non_leak = \"cut\"\n").unwrap();
    assert_eq!(cut.segment.on_leak, OnLeak::Cut);
    assert_eq!(settings(&CaseFile::of_case("i", &cut).to_toml()).unwrap(), cut);
    let refused = settings("ct = \"d\"\nseed_mm = \"auto\"\non_leak = \"refuse\"\n").unwrap_err();
    assert!(refused.starts_with("on_leak: found refuse beside auto, expected cut"), "{refused}");
}

#[test]
fn a_label_is_of_a_segmentation() {
    let refused = settings("ct = \"d\"\nseed_mm = \"auto\"\nlabel = 2\n").unwrap_err();
    assert_eq!(
        refused,
        "label: found one without a segmentation, expected the segmentation whose structure it names"
    );
}

#[test]
fn corrections_are_kept_as_they_were_written_and_checked() {
    let text = "ct = \"d\"\nseed_mm = [[1, 2, 3]]\n[[segment.block]]\nz_mm = [1, 2]\n[[segment.window]]\nz_mm = [3, 4]\n\
                window_hu = [100, 300]\n[[segment.contour]]\nz_mm = 5\npoints_mm = [[0, 0], [4, 0], [4, 4]]\n";
    let s = settings(text).unwrap();
    assert_eq!((s.segment.corrections.block.len(), s.segment.corrections.contour.len()), (1, 1));
    assert_eq!(settings(&CaseFile::of_case("i", &s).to_toml()).unwrap(), s);
    let wrong = settings(&text.replace("[1, 2]\n[[segment.w", "[2, 1]\n[[segment.w")).unwrap_err();
    assert_eq!(
        wrong,
        "segment.block[1].z_mm: found 2,1, expected two finite heights in mm, the first not above the second"
    );
}

#[test]
fn nothing_about_growing_is_taken_beside_a_ready_segmentation() {
    let ready = "segmentation = \"labels.nrrd\"\n";
    for (key, line) in [
        ("phantom", "[phantom]\nkind = \"tube\"\n"),
        ("seed_mm", "seed_mm = [[1, 2, 3]]\n"),
        ("seed_mm", "seed_mm = \"auto\"\n"),
        ("window_hu", "window_hu = [100, 300]\n"),
        ("polarity", "polarity = \"dark\"\n"),
        ("on_leak", "on_leak = \"cut\"\n"),
        ("boundary", "boundary = \"snake\"\n"),
        ("segment", "[[segment.block]]\nz_mm = [1, 2]\n"),
    ] {
        for with_ct in ["", "ct = \"d\"\n"] {
            let refused = settings(&format!("{with_ct}{ready}{line}")).unwrap_err();
            assert_eq!(
                refused,
                format!(
                    "{key}: found one beside a segmentation, expected none: in a ready segmentation the lumen is found already; leave this out, or the segmentation"
                )
            );
        }
    }
    let kept = settings(&format!("{ready}z_mm = [1, 9]\n")).unwrap();
    assert_eq!(settings(&CaseFile::of_case("i", &kept).to_toml()).unwrap(), kept);
}

#[test]
fn naming_a_wall_takes_back_a_cast_and_the_other_way_round() {
    let cast = CaseFile { cast: Some(true), ..CaseFile::default() };
    let wall = CaseFile { wall_mm: Some(2.0), ..CaseFile::default() };
    assert_eq!(Settings::try_from(wall.clone().over(cast.clone())).unwrap().body, Body::WallMm(2.0));
    assert_eq!(Settings::try_from(cast.over(wall)).unwrap().body, Body::Cast);
}
