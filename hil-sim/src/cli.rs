//! The command line.

use crate::{
    Error,
    driver::{self, Config},
    printer::Options,
    profile::{BeadShape, Profile},
    replay,
    scenario::{BAUD, NOISE_C, Scenario, Speed},
    spec::FaultSpec,
};
use clap::{Args, Parser, Subcommand};
use std::{
    ffi::OsString,
    io::Write,
    path::PathBuf,
    process::ExitCode,
    sync::{Arc, atomic::AtomicBool},
};

const FAULT_HELP: &str = "\
Faults (--fault, repeatable): KIND[:key=value,...]
  on the wire   bit-error lost-byte doubled-byte half-line garbage delay   (dir=rx, the default, or dir=tx)
                lost-ok spurious-resend wrong-resend
  of the port   disconnect silent
  of the board  reset power-cut (for-s=T: how long it is down)  kill runaway sensor-open
  of the print  layer-shift (mm=1, axis=x|y|z)  clog (percent=50)  leak (percent=20)  filament-out
  when          rate=P   probability per line            line=N   from the Nth line received on
                layer=N  from layer N on (first is 0)    at-s=T   from simulated second T on
                count=N  at most N times (default: once; without limit with rate, or for-s on the wire)
  how long      for-s=T  simulated seconds that it lasts; length of a delay (default 1)

A record holds beads.csv (one row per extruding segment), events.jsonl and summary.json.
Exit codes: 0 done, 1 the work failed, 2 wrong usage.";

/// A simulated FDM printer on a pseudo-terminal that records what it deposits
#[derive(Debug, Parser)]
#[command(name = "hil-sim", version, after_help = FAULT_HELP, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Sub>,
    #[command(flatten)]
    run: RunArgs,
}

#[derive(Debug, Subcommand)]
enum Sub {
    /// Draw one layer of a record as a picture
    Replay(ReplayArgs),
}

#[derive(Debug, Args)]
struct ReplayArgs {
    /// Record made by --record
    dir: PathBuf,
    /// Layer, counted from 0
    #[arg(long, value_name = "N")]
    layer: usize,
    /// PNG file to write
    #[arg(long, value_name = "F.png")]
    out: PathBuf,
    /// Size of a pixel, mm [default: so that the layer is 1000 pixels wide]
    #[arg(long, value_name = "MM")]
    pixel_mm: Option<f64>,
}

#[derive(Debug, Args)]
struct RunArgs {
    /// Machine: marlin, marlin1, klipper, reprapfirmware, repetier, smoothie, prusa-mk3s, reference, abs-enclosed
    /// [default: marlin]
    #[arg(long, value_name = "NAME")]
    profile: Option<String>,
    #[command(flatten)]
    other: OtherArgs,
    /// Path that becomes a symbolic link to the terminal (removed in the end)
    #[arg(long, value_name = "PATH")]
    link: Option<PathBuf>,
    /// Directory for beads.csv, events.jsonl and summary.json
    #[arg(long, value_name = "DIR")]
    record: Option<PathBuf>,
    /// How fast simulated time passes: realtime, a factor, or max [default: realtime]
    #[arg(long, value_name = "SPEED")]
    speed: Option<String>,
    /// Speed of the wire, bits per second [default: takes no time, flow-controlled as USB is]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(i64::from(*BAUD.start())..=i64::from(*BAUD.end())))]
    baud: Option<u32>,
    /// Fault to inject (see below); may be given several times
    #[arg(long, value_name = "SPEC")]
    fault: Vec<String>,
    /// TOML file with the same options and faults (keys profile, speed, baud, seed, once,
    /// sensor-noise-c, reset-on-open, faults; [[fault]] tables)
    #[arg(long, value_name = "F.toml")]
    scenario: Option<PathBuf>,
    /// Seed of the faults [default: 0]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// End when the user closes the port
    #[arg(long)]
    once: bool,
    /// By how much a temperature reading may be off, °C [default: 0]
    #[arg(long, value_name = "C")]
    sensor_noise_c: Option<f64>,
    /// Reset the board whenever the port is opened, as many boards do
    #[arg(long)]
    reset_on_open: bool,
    /// Print the summary as one JSON document on stdout in the end
    #[arg(long)]
    json: bool,
}

/// What another machine with the profile's firmware has otherwise.
#[derive(Debug, Args)]
struct OtherArgs {
    /// X,Y,Z travel of another machine with that firmware, mm [default: the profile's, as with the next four]
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',')]
    bed_mm: Option<Vec<f64>>,
    /// Its fastest X,Y,Z,E, mm/s
    #[arg(long, value_name = "X,Y,Z,E", value_delimiter = ',')]
    max_speed_mm_s: Option<Vec<f64>>,
    /// Its strongest X,Y,Z,E, mm/s2
    #[arg(long, value_name = "X,Y,Z,E", value_delimiter = ',')]
    max_acceleration_mm_s2: Option<Vec<f64>>,
    /// Its filament's diameter, mm
    #[arg(long, value_name = "MM")]
    filament_mm: Option<f64>,
    /// Cross-section of its beads
    #[arg(long, value_name = "SHAPE", value_parser = ["rectangle", "stadium"])]
    bead_shape: Option<String>,
}

impl OtherArgs {
    fn apply(self, profile: &mut Profile) -> Result<(), Error> {
        figures("--bed-mm", self.bed_mm, &mut profile.bed_mm)?;
        figures("--max-speed-mm-s", self.max_speed_mm_s, &mut profile.max_speed_mm_s)?;
        figures(
            "--max-acceleration-mm-s2",
            self.max_acceleration_mm_s2,
            &mut profile.max_acceleration_mm_s2,
        )?;
        let mut filament_mm = [profile.filament_mm];
        figures("--filament-mm", self.filament_mm.map(|mm| vec![mm]), &mut filament_mm)?;
        [profile.filament_mm] = filament_mm;
        match self.bead_shape.as_deref() {
            Some("rectangle") => profile.bead_shape = BeadShape::Rectangle,
            Some(_) => profile.bead_shape = BeadShape::Stadium,
            None => {}
        }
        Ok(())
    }
}

/// The figures of an option in place of the profile's.
fn figures<const N: usize>(option: &str, given: Option<Vec<f64>>, own: &mut [f64; N]) -> Result<(), Error> {
    let Some(given) = given else { return Ok(()) };
    let is_good = |v: &f64| v.is_finite() && *v > 0.0;
    *own = <[f64; N]>::try_from(given).ok().filter(|all| all.iter().all(is_good)).ok_or_else(|| {
        Error::Option { option: option.to_owned(), problem: format!("{N} numbers above 0 are expected") }
    })?;
    Ok(())
}

/// Runs the program with `args` (the program's name first).
pub fn main_from(args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version are no errors; a closed stdout is nobody's concern.
            drop(error.print());
            return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
        }
    };
    let result = match cli.command {
        Some(Sub::Replay(args)) => replay::draw_file(&args.dir, args.layer, &args.out, args.pixel_mm),
        None => run(cli.run),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            complain(&format!("hil-sim: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

/// Says something on stderr; where that is closed, nobody listens.
fn complain(text: &str) {
    drop(writeln!(std::io::stderr(), "{text}"));
}

fn run(args: RunArgs) -> Result<(), Error> {
    let json = args.json;
    let config = configure(args)?;
    let stop = stop_flag()?;
    let name = config.options.profile.name;
    let link = config.link.clone();
    let summary = driver::run(config, &stop, |pty| {
        complain(&format!("hil-sim: {name} on {} ({})", link.display(), pty.device.display()));
    })?;
    if json {
        let text = serde_json::to_string(&summary).expect("a summary has no map with odd keys");
        writeln!(std::io::stdout(), "{text}").map_err(|error| Error::io("write", "stdout", error))?;
    }
    Ok(())
}

/// Command line over scenario over defaults.
fn configure(args: RunArgs) -> Result<Config, Error> {
    let scenario = match &args.scenario {
        Some(path) => {
            let text = std::fs::read_to_string(path).map_err(|error| Error::io("read", path, error))?;
            Scenario::parse(path, &text)?
        }
        None => Scenario::default(),
    };
    let wrong = |option: &str, problem: String| Error::Option { option: option.to_owned(), problem };
    let speed =
        args.speed.map(|text| text.parse()).transpose().map_err(|problem| wrong("--speed", problem))?;
    let mut faults = scenario.faults;
    for spec in &args.fault {
        faults.push(spec.parse::<FaultSpec>()?);
    }
    let name = args.profile.or(scenario.profile).unwrap_or_else(|| "marlin".to_owned());
    let mut profile = Profile::by_name(&name)?;
    args.other.apply(&mut profile)?;
    profile.sensor_noise_c = args.sensor_noise_c.or(scenario.sensor_noise_c).unwrap_or(0.0);
    if !NOISE_C.contains(&profile.sensor_noise_c) {
        let problem =
            format!("{} found, {} to {} is expected", profile.sensor_noise_c, NOISE_C.start(), NOISE_C.end());
        return Err(wrong("--sensor-noise-c", problem));
    }
    profile.resets_on_open |= args.reset_on_open || scenario.reset_on_open.unwrap_or(false);
    let link = args.link.ok_or_else(|| {
        wrong("--link", "a path is needed, which becomes a link to the terminal".to_owned())
    })?;
    Ok(Config {
        options: Options {
            profile,
            baud: args.baud.or(scenario.baud),
            faults,
            seed: args.seed.or(scenario.seed).unwrap_or(0),
            record_commands: args.record.is_some(),
        },
        link,
        record: args.record,
        speed: speed.or(scenario.speed).unwrap_or(Speed::Times(1.0)),
        once: args.once || scenario.once.unwrap_or(false),
    })
}

/// A flag that interruption and termination raise.
fn stop_flag() -> Result<Arc<AtomicBool>, Error> {
    let flag = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM, signal_hook::consts::SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&flag))
            .map_err(|error| Error::io("listen to", format!("signal {signal}"), error))?;
    }
    Ok(flag)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn configured(args: &[&str]) -> Result<Config, Error> {
        let cli = Cli::try_parse_from(["hil-sim"].iter().chain(args)).expect("usage");
        configure(cli.run)
    }

    #[test]
    fn command_line_is_consistent() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }

    #[test]
    fn command_line_goes_before_the_scenario() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("s.toml");
        std::fs::write(&file, "profile = \"reference\"\nspeed = 4\nseed = 9\nfaults = [\"kill:line=3\"]\n")
            .unwrap();
        let file = file.to_str().unwrap();
        let config =
            configured(&["--link", "x", "--scenario", file, "--seed", "1", "--fault", "reset:line=5"])
                .unwrap();
        assert_eq!(config.options.profile.name, "reference");
        assert_eq!((config.options.seed, config.speed), (1, Speed::Times(4.0)));
        assert_eq!(config.options.faults.len(), 2);
    }

    #[test]
    fn another_machine_has_its_own_sizes_and_limits() {
        let built_in = configured(&["--link", "x", "--profile", "klipper"]).unwrap().options.profile;
        let other =
            ["--bed-mm", "235,230,280.5", "--max-speed-mm-s", "400,400,20,80", "--filament-mm", "2.85"];
        let more = ["--max-acceleration-mm-s2", "4000,4000,200,5000", "--bead-shape", "rectangle"];
        let args = [&["--link", "x", "--profile", "klipper"], &other[..], &more[..]].concat();
        let profile = configured(&args).unwrap().options.profile;
        let expected = Profile {
            bed_mm: [235.0, 230.0, 280.5],
            max_speed_mm_s: [400.0, 400.0, 20.0, 80.0],
            max_acceleration_mm_s2: [4000.0, 4000.0, 200.0, 5000.0],
            filament_mm: 2.85,
            bead_shape: BeadShape::Rectangle,
            ..built_in
        };
        assert_eq!(profile, expected);
    }

    #[test]
    fn wrong_usage_has_code_2_and_names_what_is_wrong() {
        for (args, part) in [
            (&["--profile", "marlin"][..], "--link"),
            (&["--link", "x", "--profile", "no"], "unknown profile `no`"),
            (&["--link", "x", "--speed", "0"], "--speed"),
            (&["--link", "x", "--bed-mm", "200,0,200"], "--bed-mm"),
            (&["--link", "x", "--bed-mm", "200,200"], "3 numbers above 0"),
            (&["--link", "x", "--sensor-noise-c", "70"], "70 found, 0 to 5 is expected"),
            (&["--link", "x", "--fault", "explode"], "unknown kind `explode`"),
        ] {
            let error = configured(args).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains(part), "{error}");
        }
        let missing = configured(&["--link", "x", "--scenario", "no-such.toml"]).unwrap_err();
        assert!(missing.to_string().contains("no-such.toml"), "{missing}");
    }
}
