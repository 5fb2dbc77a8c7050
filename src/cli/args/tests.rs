use super::*;
use clap::CommandFactory;

fn refused(args: &[&str]) -> String {
    usage_line(&Cli::try_parse_from([&["lumenfab"], args].concat()).unwrap_err())
}

fn parse(args: &[&str]) -> Command {
    Cli::try_parse_from([&["lumenfab"], args].concat()).unwrap().command.unwrap()
}

#[test]
fn the_definition_is_sound() {
    Cli::command().debug_assert();
}

#[test]
fn profiles_alone_names_what_may_follow() {
    let line = refused(&["profiles"]);
    assert_eq!(
        line,
        "profiles: found nothing behind it, expected one of list, show, detect, check (see --help)"
    );
}

#[test]
fn negative_coordinates_may_stand_alone_or_behind_an_equals_sign() {
    for args in [vec!["--seed-mm=-221.4,22.5,165.2"], vec!["--seed-mm", "-221.4,22.5,165.2"]] {
        let cli = Cli::try_parse_from([vec!["lumenfab", "run"], args].concat()).unwrap();
        let Some(Command::Run(run)) = cli.command else { panic!("not run") };
        assert_eq!(run.ct.seed_mm, [Seed::Point([-221.4, 22.5, 165.2])]);
    }
}

#[test]
fn gaps_are_allowed_and_a_rate_is_set_only_where_asked_for() {
    for (args, allowed) in [
        (vec!["segment", "c"], None),
        (vec!["segment", "c", "--allow-gaps"], Some(true)),
        (vec!["segment", "--allow-gaps", "c"], Some(true)),
        (vec!["segment", "c", "--allow-gaps=false"], Some(false)),
    ] {
        let Command::Segment(segment) = parse(&args) else { panic!("not segment") };
        assert_eq!(segment.ct.patch().allow_gaps, allowed);
    }
    let Command::Print(print) = parse(&["print", "c", "--baud", "250000"]) else { panic!("not print") };
    assert_eq!(print.baud, Some(250_000));
    assert!(refused(&["print", "c", "--baud", "12"]).starts_with("--baud: "));
}

#[test]
fn the_sample_services_run_commands_that_there_are() {
    let units = [
        include_str!("../../../deploy/lumenfab-print@.service"),
        include_str!("../../../deploy/lumenfab.service"),
        include_str!("../../../deploy/lumenfab-safe-off.service"),
    ];
    let text = units.concat().replace("${HOLD_S}", "1800");
    let commands: Vec<_> = text
        .lines()
        .filter(|line| line.starts_with("Exec"))
        .filter_map(|line| line.split_once("/usr/bin/lumenfab "))
        .map(|(_, command)| command.trim_end_matches('\'').replace("\"$$after\"", "1800"))
        .collect();
    assert_eq!(commands.len(), 5);
    for command in commands {
        let args: Vec<_> = command.split_ascii_whitespace().collect();
        match parse(&args) {
            Command::Print(print) => assert_eq!(print.what, PathBuf::from("%i.gcode")),
            Command::SafeOff(safe_off) => {
                let of_server = safe_off.state == Some(PathBuf::from("%S/lumenfab"));
                assert!(of_server || safe_off.after_s == 1800, "{safe_off:?}");
            }
            Command::Serve(serve) => assert_eq!(serve.state.state, None),
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_refused_flag_is_one_line_with_found_and_expected() {
    for (args, line) in [
        (
            vec!["run", "--seed-mm", "1,2"],
            "--seed-mm: found \"1,2\", expected X,Y,Z: three numbers in mm (LPS) separated by commas; or auto",
        ),
        (
            vec!["run", "--seed-mm", "1,NaN,2"],
            "--seed-mm: found \"1,NaN,2\", expected X,Y,Z: three numbers in mm (LPS) separated by commas; or auto",
        ),
        (
            vec!["run", "--window-hu", "300,200"],
            "--window-hu: found 300,200, expected LO,HI: two numbers in HU separated by a comma, LO less than HI",
        ),
        (vec!["run", "--wall-mm", "0"], "--wall-mm: found 0, expected a number from 0.1 to 20 mm"),
        (vec!["run", "--layer-mm=-0.2"], "--layer-mm: found -0.2, expected a number from 0.02 to 1 mm"),
        (
            vec!["run", "--z-mm", "9,1"],
            "--z-mm: found 9,1, expected A,B: two heights in mm separated by a comma, A less than B",
        ),
    ] {
        assert_eq!(refused(&args), line, "{args:?}");
    }
    for args in [vec!["export", "c"], vec!["runn"], vec!["run", "--wal-mm", "1"], vec!["slice"]] {
        let line = refused(&args);
        assert!(!line.contains('\n') && line.ends_with("(see --help)"), "{line}");
    }
}
