use super::*;

fn changed(line: &str, replacement: &str) -> String {
    let text = builtin_text("marlin").unwrap();
    assert!(text.contains(line), "{line} is not in the file");
    text.replace(line, replacement)
}

fn error_of(text: &str) -> String {
    parse(text, "x.toml").unwrap_err().to_string()
}

#[test]
fn every_builtin_profile_is_valid_and_has_its_name() {
    for name in builtin_names() {
        let profile = builtin(name).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(profile.name, name);
    }
}

#[test]
fn every_profile_file_is_built_in() {
    let dir = concat!(env!("CARGO_MANIFEST_DIR"), "/firmware-profiles");
    for entry in std::fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        assert!(builtin_names().contains(&name.as_str()), "{name} is not built in");
        assert_eq!(from_file(&path).unwrap(), builtin(&name).unwrap());
    }
}

#[test]
fn the_schema_knows_exactly_the_keys_of_a_profile() {
    let text = toml::to_string(&builtin_whole("marlin").unwrap()).unwrap();
    let layers = Layers::parse(&text, "x").unwrap();
    let mut known: Vec<_> = schema::FIELDS.iter().map(|f| f.key.to_owned()).collect();
    known.sort();
    assert_eq!(layers.keys.into_keys().collect::<Vec<_>>(), known);
}

#[test]
fn a_profile_survives_being_written_and_read() {
    for name in builtin_names() {
        let profile = builtin(name).unwrap();
        assert_eq!(parse(&to_toml(&profile), "x").unwrap(), profile);
    }
}

#[test]
fn the_reference_machine_adds_nothing_to_the_part() {
    let p = builtin("reference").unwrap();
    assert_eq!(p.machine.bed_mm, [200.0, 200.0, 250.0]);
    assert_eq!((p.machine.nozzle_mm, p.machine.filament_mm), (0.4, 1.75));
    assert_eq!(p.print.bead_shape, BeadShape::Rectangle);
    assert_eq!((p.print.skirt_loops, p.print.brim_mm), (0, 0.0));
    assert_eq!((p.filament.flow_percent, p.filament.shrinkage_percent), (100.0, 0.0));
    assert_eq!((p.print.hole_compensation_mm, p.print.first_layer_compensation_mm), (0.0, 0.0));
    assert_eq!(p.firmware.dialect, Dialect::Marlin);
    assert!(
        !p.firmware.arcs && p.print.wipe_mm == 0.0 && p.filament.fan_least_percent == p.filament.fan_percent
    );
}

#[test]
fn scripts_are_filled_with_temperatures_and_sizes() {
    let p = builtin("marlin").unwrap();
    let start = p.start_gcode();
    assert!(start.contains(&"M109 S210".to_owned()) && start.contains(&"M190 S60".to_owned()), "{start:?}");
    assert!(p.end_gcode(100.2).contains(&"G1 X0 Y220 F6000".to_owned()));
    assert!(p.end_gcode(100.2).contains(&"G1 Z105.2 F600".to_owned()));
    assert!(p.end_gcode(248.0).contains(&"G1 Z250 F600".to_owned()), "above the machine");
    assert!(!start.iter().chain(&p.end_gcode(0.0)).any(|l| l.contains('{')));
}

#[test]
fn a_value_out_of_range_names_file_line_key_value_range_and_unit() {
    let text = changed("nozzle_mm = 0.4", "nozzle_mm = 400");
    let line = text.lines().position(|l| l == "nozzle_mm = 400").unwrap() + 1;
    let expected = format!("x.toml:{line}: machine.nozzle_mm = 400: expected a number from 0.05 to 3 mm");
    assert_eq!(error_of(&text), expected);
}

#[test]
fn an_inherited_wrong_value_is_reported_where_it_was_written() {
    let text = "inherits = \"marlin\"\nname = \"mine\"\n[machine]\nbed_mm = [200, 200]\n";
    assert_eq!(
        error_of(text),
        "x.toml:4: machine.bed_mm = [200, 200]: expected 3 numbers from 10 to 5000 mm"
    );
}

#[test]
fn a_file_without_a_name_of_its_own_is_not_called_what_it_inherits_from() {
    let name = |text: &str| parse(text, "x.toml").unwrap().name;
    assert_eq!(name("inherits = \"prusa-mk3s\"\n[print]\nperimeters = 3\n"), "prusa-mk3s, changed");
    assert_eq!(name("inherits = \"prusa-mk3s\"\nname = \"mine\"\n"), "mine");
}

#[test]
fn a_script_that_cannot_be_meant_is_refused_with_its_line() {
    let with = |scripts: &str| format!("inherits = \"marlin\"\nname = \"x\"\n[scripts]\n{scripts}\n");
    for (scripts, expected) in [
        ("start = [\"G28\", \"M112\"]", "`M112`: it stops the printer"),
        ("end = [\"M104 S0\", \"G1 X500 F3000\"]", "`G1 X500 F3000`: it leaves the machine"),
        ("end = [\"G90\", \"G0 Z-40\"]", "`G0 Z-40`: it leaves the machine"),
        ("safe = [\"M104 S0\", \"G28 X\"]", "`G28 X`: it moves"),
    ] {
        let error = error_of(&with(scripts));
        assert!(error.contains("x.toml:4: scripts.") && error.contains(expected), "{scripts}: {error}");
    }
    // Beside the bed, by steps, and at once where everything is to be stopped.
    for scripts in [
        "start = [\"G28\", \"G1 Y-3 X20 F3000\"]",
        "end = [\"G91\", \"G1 Z-100\", \"G90\"]",
        "safe = [\"M112\"]",
    ] {
        parse(&with(scripts), "x.toml").unwrap();
    }
}

#[test]
fn each_kind_of_wrong_value_is_refused() {
    for (line, replacement, expected) in [
        ("baud = 115200", "baud = 12.5", "firmware.baud = 12.5: expected a whole number"),
        ("line_numbers = true", "line_numbers = 1", "firmware.line_numbers = 1: expected true or false"),
        ("resend_style = \"resend\"", "resend_style = \"shout\"", "expected one of resend, rs"),
        ("dialect = \"marlin\"", "dialect = \"latin\"", "expected one of marlin"),
        ("material = \"PLA\"", "material = \" \"", "expected a text of one line that is not empty"),
        (
            "material = \"PLA\"",
            "material = \"PLA\\nM104 S300\"",
            "expected a text of one line that is not empty",
        ),
        ("nozzle_mm = 0.4", "nozzle_mm = nan", "expected a number from"),
        ("layer_height_mm = [0.05, 0.32]", "layer_height_mm = [0.3, 0.1]", "the smaller one first"),
        ("layer_height_mm = [0.05, 0.32]", "layer_height_mm = [0.1, 0.5]", "no thicker than the nozzle"),
        ("extrusion_width_mm = 0.45", "extrusion_width_mm = 0.9", "from 0.3 to 0.8 mm"),
        ("travel_mm_s = 150", "travel_mm_s = 900", "at most 500 mm/s"),
        ("safe = [\"M104 S0\", \"M140 S0\", \"M107\"]", "safe = []", "switch the heaters off"),
        ("\"M107\",\n    \"G90\"", "\"M107 ; fan\",\n    \"G90\"", "without line breaks or comments"),
        (
            "cornering = \"junction-deviation\"",
            "cornering = \"square-corner\"",
            "expected \"junction-deviation\" or \"jerk\" with",
        ),
        ("object_labels = \"m486\"", "object_labels = \"exclude-object\"", "expected m486 or none with"),
        ("\"G28\"", "\"G28 {speed}\"", "{speed} in \"G28 {speed}\""),
        ("\"G28\"", "\"G28 {bed_c\"", "expected one of {hotend_c}"),
        ("\"G28\"", &format!("\"G28 {}\"", "X".repeat(90)), "firmware.line_bytes"),
    ] {
        let error = error_of(&changed(line, replacement));
        assert!(error.contains(expected), "{replacement}: {error}");
        assert!(error.starts_with("x.toml:") && !error.contains('\n'), "{error}");
    }
}

#[test]
fn a_missing_key_is_named() {
    let error = error_of(&changed("baud = 115200\n", ""));
    assert!(error.starts_with("x.toml: firmware.baud is missing; expected a whole number"), "{error}");
}

#[test]
fn an_unknown_key_is_named_with_its_line_and_a_hint() {
    let error = error_of("inherits = \"marlin\"\nnozzle_mm = 0.4\n");
    assert_eq!(error, "x.toml:2: nozzle_mm: no profile has this key (did you mean machine.nozzle_mm?)");
    let error = error_of("inherits = \"marlin\"\n[print]\nretract = 1\n");
    assert!(error.contains("x.toml:3: print.retract:") && error.contains("print.retract_mm"), "{error}");
    let error = error_of("inherits = \"marlin\"\n[print]\nbrim_slendernes = 1\n");
    assert!(error.contains("(did you mean print.brim_slenderness?)"), "{error}");
    assert!(error_of("inherits = \"marlin\"\n[name]\nfoo = 1\n").contains("x.toml:3: name.foo: no profile"));
    let error = error_of("inherits = \"marlin\"\n[print]\n\"\" = 1\n");
    assert!(error.contains("x.toml:3: print.:"), "{error}");
}

#[test]
fn a_file_of_something_else_is_told_in_one_line() {
    let error = error_of("format = 3\nid = \"x\"\nwall_mm = 1\n[solid]\ncorrespondence = \"least\"\n");
    assert!(error.starts_with("x.toml: not a profile: ") && error.contains("(found format, id, "), "{error}");
    assert_eq!(error.lines().count(), 1);
}

#[test]
fn an_unknown_base_is_refused() {
    let error = error_of("inherits = \"martian\"\n");
    assert!(error.contains("x.toml:1: inherits") && error.contains("smoothie, reference"), "{error}");
    assert!(error_of("inherits = 3\n").contains("x.toml:1: inherits = 3"));
}

#[test]
fn text_that_is_not_toml_is_refused_with_its_line() {
    let error = error_of("name = \"a\"\nwhat is this\n");
    assert!(error.starts_with("x.toml:2: not a profile: "), "{error}");
    assert!(!error.contains('\n'));
}

#[test]
fn an_unknown_name_lists_the_known_ones() {
    let error = builtin("nonesuch").unwrap_err().to_string();
    assert_eq!(
        error,
        "there is no profile \"nonesuch\"; built in are marlin, marlin1, klipper, reprapfirmware, repetier, smoothie, \
         reference, abs-enclosed, prusa-mk3s, a file is given by its path"
    );
}

#[test]
fn a_file_that_is_not_there_is_named() {
    let error = load::by_name("/nonexistent/p.toml").unwrap_err().to_string();
    assert!(error.starts_with("/nonexistent/p.toml: the profile cannot be read"), "{error}");
    assert_eq!(load::by_name("marlin").unwrap().name, "marlin");
}

#[test]
fn a_file_on_disk_can_inherit() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("mine.toml");
    std::fs::write(&path, "inherits = \"reference\"\nname = \"mine\"\n[print]\nperimeters = 3\n").unwrap();
    let profile = from_file(&path).unwrap();
    assert_eq!((profile.name.as_str(), profile.print.perimeters), ("mine", 3));
    assert_eq!(profile.machine, builtin("reference").unwrap().machine);
}

proptest::proptest! {
    #[test]
    fn any_text_gives_a_profile_or_a_line_for_each_fault(text in "[a-z\\[\\]=\"{}.0-9\n -]{0,200}") {
        if let Err(error) = parse(&text, "x") {
            let n_lines = match &error {
                Error::Several(faults) if faults.len() > MOST_FAULTS => MOST_FAULTS + 1,
                Error::Several(faults) => faults.len(),
                _ => 1,
            };
            proptest::prop_assert_eq!(error.to_string().lines().count(), n_lines);
        }
    }
}

#[test]
fn every_fault_of_a_profile_is_told() {
    let text =
        "inherits = \"marlin\"\n[machine]\nnozzle_mm = 400\n[print]\nretract = 1\nsupport = \"wood\"\n";
    let error = error_of(text);
    let lines: Vec<&str> = error.lines().collect();
    assert_eq!(lines.len(), 3, "{error}");
    for (line, key) in lines.iter().zip([
        "x.toml:5: print.retract",
        "x.toml:3: machine.nozzle_mm",
        "x.toml:6: print.support",
    ]) {
        assert!(line.starts_with(key), "{line}");
    }
    let at_odds = "inherits = \"marlin\"\n[machine]\nlayer_height_mm = [0.1, 0.5]\n[print]\ntravel_mm_s = 900\ninfill_mm_s = 700\n";
    assert_eq!(error_of(at_odds).lines().count(), 3, "{}", error_of(at_odds));
    let nothing = error_of("name = \"mine\"\n");
    assert!(nothing.lines().count() == MOST_FAULTS + 1 && nothing.contains("\nand "), "{nothing}");
}

#[test]
fn a_profile_changes_single_limits_of_the_gate_and_nothing_of_the_job() {
    let usual = gate::builtin("marlin").unwrap();
    for name in builtin_names() {
        assert_eq!(gate::builtin(name).unwrap(), usual);
    }
    let strict =
        parse_whole("inherits = \"marlin\"\nname = \"marlin\"\n[gate]\ntotal_p95_mm = 0.1\n", "x").unwrap();
    assert_eq!(strict.gate, Gate { total_p95_mm: 0.1, ..usual });
    assert_eq!(strict.profile, builtin("marlin").unwrap());
    // What was written without a gate is judged by the usual one.
    assert_eq!(parse_whole(&to_toml(&strict.profile), "x").unwrap().gate, usual);
    let wrong = "inherits = \"marlin\"\n[gate]\nlayer_iou = 97\n";
    let error = parse_whole(wrong, "x.toml").unwrap_err().to_string();
    assert!(error.contains("x.toml:3") && error.contains("gate.layer_iou"), "{error}");
}
