//! What may be written on the command line. Each flag is checked here as far as it can be without its file.

pub(super) mod queue;
mod values;

use crate::app::settings::{
    self, CaseFile, DEFAULT_LAYER_MM, DEFAULT_PROFILE, DEFAULT_WALL_MM, LAYER_MM, SIMULATED_PORT, Seed,
    Seeds, SeriesKey, WALL_MM,
};
use crate::app::{Colouring, Skin, View};
use crate::model::Axis;
use crate::phantom::{self, Contrast, Kind};
use crate::ready::Label;
use crate::sections::Boundary;
use crate::segment::{OnLeak, Polarity};
use crate::view::Direction;
use clap::{ArgGroup, Args, Parser, Subcommand};
use queue::{BackupArgs, QueueArgs, ServeArgs, TuiArgs};
use std::num::NonZeroUsize;
use std::path::PathBuf;
use values::{
    colouring, deflection_mm, deflection_relative, help, infill_percent, layer_mm, named, noise_hu, orient,
    public_key, range_help, wall_mm,
};

/// From a CT series of a blood vessel to a printed replica of its lumen, with proof of how faithful it is.
///
/// Without a command: the whole way once, with a built-in synthetic CT and a simulated printer.
#[derive(Debug, Parser)]
#[command(name = "lumenfab", version, max_term_width = 110, after_help = INTENDED_USE)]
pub(crate) struct Cli {
    /// One JSON document on stdout instead of text; progress and messages stay on stderr
    #[arg(long, global = true)]
    pub(crate) json: bool,
    #[command(subcommand)]
    pub(crate) command: Option<Command>,
}

/// Said in the README and in every report too.
const INTENDED_USE: &str = "Intended use: models for planning, teaching and research; not a medical device unless \
the user's institution validates it as one.\n\nExit codes: 0 done; 1 the work failed; 2 wrong usage or \
configuration; 3 done, but the quality gate of the report failed; 130 interrupted.";

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// The main job: every stage from CT to report
    Run(RunArgs),
    /// Write a synthetic CT as a DICOM series, with its truth
    Phantom(PhantomArgs),
    /// Show which series a folder holds, their geometry and what is wrong with them
    Inspect {
        /// Folder with DICOM files, DICOMDIR, one DICOM file, or an image file: NIfTI, MetaImage, NRRD
        path: PathBuf,
    },
    /// CT to contours: start a case with --ct and --out, or do the stage again
    Segment(SegmentArgs),
    /// Contours to the solid: start a case with --sections and --out, or do the stage again
    ///
    /// A hollow wall is open at the ends of the stack, a cast is closed. Points of neighbouring contours correspond by
    /// least twist; `[solid] correspondence = "published"` in case.toml takes the published rule for comparison: start at
    /// the least x, then at the nearest point.
    Solid(SolidArgs),
    /// Solid to layers, toolpaths and G-code
    Slice(SliceArgs),
    /// G-code to the printer
    ///
    /// On a real port a journal is kept beside the job (JOB.gcode.journal). A cable that was out is waited for, and the print goes on
    /// by itself exactly where it was.
    ///
    /// Keys, where stdin is a terminal: p pause, c go on, x twice cancel, ! stop at once, a digit answers the printer's question.
    /// Else SIGUSR1 pauses, SIGUSR2 goes on.
    Print(PrintArgs),
    /// Go on with a print that broke off
    ///
    /// Where the printer still lives (the host or the cable failed), each move is made exactly once: it is asked for its last
    /// line and its place. After a reset or a power cut this says where it would go on, and how much may be printed twice;
    /// --after-reset then does it. A picture of the layer is written beside the job (JOB.gcode.resume.svg).
    Resume(ResumeArgs),
    /// Switch the heaters of a printer off, for a service manager whose lumenfab is gone
    ///
    /// Heaters-off is sent until the printer itself says that the targets are 0. What a print that broke off needs to go on exactly is
    /// left as it is. `deploy/lumenfab-print@.service` shows how a service manager runs it.
    SafeOff(SafeOffArgs),
    /// Compare image, contours, solid, toolpaths and deposition
    ///
    /// With --dicom the report also goes into the patient's study, as an Encapsulated PDF in a new series: who the patient is is
    /// read from the CT at that moment and kept nowhere else.
    ///
    /// With --scan a CT of the printed replica (in air; for a hollow one air in its lumen, too) is laid over the model and compared
    /// plane by plane, as a stage of its own, `scan`. Nothing of the scan but its figures is kept. A scan that does not fit, or fits in
    /// several ways, is refused; a mirror image is told.
    Report {
        /// Case directory
        case: PathBuf,
        /// CT of the printed replica: a folder with DICOM files, or an image file: NIfTI, MetaImage, NRRD
        #[arg(long, value_name = "PATH")]
        scan: Option<PathBuf>,
        /// Which series of --scan, where the folder holds several: its number as `lumenfab inspect` lists it, from 1
        #[arg(long, value_name = "N", requires = "scan")]
        scan_series: Option<NonZeroUsize>,
        /// Folder for the DICOM object; it names the patient, as the CT does
        #[arg(long, value_name = "DIR", requires = "source")]
        dicom: Option<PathBuf>,
        /// The CT that the case was made from
        #[arg(long, value_name = "PATH", requires = "dicom")]
        source: Option<PathBuf>,
    },
    /// Find out whether anything in a case was changed since it was made
    ///
    /// Every stage seals the case: its record of hashes is signed with a key that belongs to this installation. Exit code 1 where
    /// a file was changed or is gone, or where the seal is missing, forged or that of another installation.
    Verify {
        /// Case directory
        case: PathBuf,
        /// Public key of the installation that sealed the case, as `verify` prints it there [default: this one's]
        #[arg(long, value_name = "HEX", value_parser = public_key)]
        key: Option<String>,
    },
    /// Write the solid for other programs: STL, 3MF, STEP, or a table of triangles against deflections
    Export(ExportArgs),
    /// The appliance: owns printers, queue and API until it is asked to stop
    ///
    /// Everything it keeps lies in its state directory, which one server has alone; config.toml there says what it does (`deploy/config.toml`
    /// explains every key), without it there is one simulated printer. SIGTERM ends it as the configuration says, each further signal
    /// more strictly; a print is never dropped cold. Clients: `lumenfab queue`, slicers, browsers.
    Serve(ServeArgs),
    /// The screen of the lab: printer, queue, and what awaits you
    ///
    /// A client of the server: leaving it changes nothing. Without a server it offers to start one. `?` shows all keys, `:` finds every
    /// command by its name.
    Tui(TuiArgs),
    /// The print queue of a running server
    Queue(QueueArgs),
    /// Write all that a server keeps into one file, while it goes on: queue, configuration, keys, files of jobs
    Backup(BackupArgs),
    /// Make a state directory from a backup
    ///
    /// Into a directory that is not there yet, or empty, and only where all of the backup is as it was written. Jobs that were queued
    /// then, or taken and not begun, are held: they may have been printed since. `lumenfab queue release JOB` lets one go. All beds are in doubt.
    Restore(BackupArgs),
    /// Find what is wrong with an installation of the appliance, and how it is mended
    ///
    /// Looks at the state directory, the disk, the queue with its whole history (a copy of it), keys, configuration, printers' profiles and
    /// ports, and whether a server answers. Changes nothing, opens no port. Exit code 1 where something does not work.
    Doctor(ServeArgs),
    /// Firmware and machine profiles
    #[command(subcommand)]
    Profiles(ProfilesCommand),
    /// What a server has done about a case: a line of JSON on stdin, lines of JSON on stdout
    #[command(hide = true)]
    Errand,
    /// The simulated printer, as a process of its own
    #[command(name = "hil-sim", disable_help_flag = true)]
    HilSim {
        /// As for the program `hil-sim`
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        args: Vec<std::ffi::OsString>,
    },
}

#[derive(Debug, Args)]
pub(crate) struct RunArgs {
    /// Case directories, case files (TOML; `ct = PATH` and any of the flags below with underscores), or folders of
    /// case files
    #[arg(value_name = "CASE.toml|DIR")]
    pub(crate) cases: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) ct: CtArgs,
    #[command(flatten)]
    pub(crate) body: BodyArgs,
    #[command(flatten)]
    pub(crate) layer: LayerArgs,
    #[command(flatten)]
    pub(crate) printer: PrinterArgs,
    #[command(flatten)]
    pub(crate) over: GivingUpArgs,
    /// Case directory to make or to go on with [default: lumenfab-case; for a case file: beside it, its name
    /// without .toml]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

/// What becomes of a job whose print broke off.
#[derive(Debug, Args)]
pub(crate) struct GivingUpArgs {
    /// Make a job anew although its last print broke off: the bed is free, and that print is not to be resumed
    #[arg(long = "anew")]
    pub(crate) gives_up: bool,
}

/// Where the lumen is found, and how.
#[derive(Debug, Args, Default)]
pub(crate) struct CtArgs {
    /// Folder with the DICOM files of a CT series, DICOMDIR, multi-frame DICOM file, or an image file: NIfTI, MetaImage,
    /// NRRD
    #[arg(long, value_name = "PATH")]
    pub(crate) ct: Option<PathBuf>,
    /// A segmentation made elsewhere, with or without --ct: a label map (NIfTI, MetaImage, NRRD), DICOM SEG or
    /// RTSTRUCT
    #[arg(long, value_name = "FILE")]
    pub(crate) segmentation: Option<PathBuf>,
    /// Which structure of the segmentation, where it holds several: its number or its name
    #[arg(long, value_name = "N|NAME", value_parser = settings::parse_label)]
    pub(crate) label: Option<Label>,
    /// Which series, where the folder holds several: its number as `lumenfab inspect` lists it, from 1, or its UID, which
    /// is not kept
    #[arg(long, value_name = "N|UID", value_parser = settings::parse_series)]
    pub(crate) series: Option<SeriesKey>,
    /// Use a series, or a DICOM SEG or RTSTRUCT, with missing planes all the same, with a warning: the lumen is
    /// interpolated across the gap; --allow-gaps=false takes it back for a case
    #[arg(long, value_name = "true|false", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    pub(crate) allow_gaps: Option<bool>,
    /// A point inside the lumen: patient coordinates (LPS), mm; may be given more than once; or auto: the vessel
    /// is found by itself, and ends where it leaks or fades
    #[arg(long, value_name = "X,Y,Z|auto", value_parser = settings::parse_seed_mm, allow_hyphen_values = true)]
    pub(crate) seed_mm: Vec<Seed>,
    /// Intensities of the lumen, HU, LO < HI [default: found from the seed's neighbourhood]
    #[arg(long, value_name = "LO,HI", value_parser = settings::parse_window_hu, allow_hyphen_values = true)]
    pub(crate) window_hu: Option<[f64; 2]>,
    /// Whether the lumen is brighter or darker than its wall; auto: found from the seed's neighbourhood
    /// [default: auto]
    #[arg(long, value_parser = named([("bright", Polarity::Bright), ("dark", Polarity::Dark), ("auto", Polarity::Auto)]))]
    pub(crate) polarity: Option<Polarity>,
    /// What is done where the lumen runs into something else: refuse, with the place and a picture; or cut, as auto does: the
    /// vessel ends there, with a warning [default: refuse]
    #[arg(long, value_parser = named([("refuse", OnLeak::Refuse), ("cut", OnLeak::Cut)]))]
    pub(crate) on_leak: Option<OnLeak>,
    /// Which grey value the boundary is. model: the likeliest cause of the image; half-maximum: half-way between lumen
    /// and wall; snake: the steepest fall, by a closed active contour, to compare with (less exact than half-maximum on
    /// the phantoms); window-edge: the end of the window that faces the wall; auto: where a window is given its edge,
    /// else the model's [default: auto]
    #[arg(long, value_parser = named([("auto", Boundary::Auto), ("model", Boundary::Model),
        ("half-maximum", Boundary::HalfMaximum), ("snake", Boundary::Snake),
        ("window-edge", Boundary::WindowEdge)]))]
    pub(crate) boundary: Option<Boundary>,
    /// Planes to use: heights along the stack's normal, mm, A < B [default: all]
    #[arg(long, value_name = "A,B", value_parser = settings::parse_z_mm, allow_hyphen_values = true)]
    pub(crate) z_mm: Option<[f64; 2]>,
}

/// What is printed.
#[derive(Debug, Args, Default)]
pub(crate) struct BodyArgs {
    #[arg(long, value_name = "T", value_parser = wall_mm, allow_hyphen_values = true, conflicts_with = "cast",
          help = help("Print a hollow vessel with a wall of this thickness", WALL_MM, DEFAULT_WALL_MM))]
    pub(crate) wall_mm: Option<f64>,
    /// Print the lumen as a solid body instead
    #[arg(long)]
    pub(crate) cast: bool,
}

/// How it is sliced.
#[derive(Debug, Args, Default)]
pub(crate) struct LayerArgs {
    #[arg(long, value_name = "H", value_parser = layer_mm, allow_hyphen_values = true,
          help = help("Layer height, within the profile's limits", LAYER_MM, DEFAULT_LAYER_MM))]
    pub(crate) layer_mm: Option<f64>,
    #[arg(long, value_name = "NAME|FILE",
          help = format!("Profile of the printer: a name (`lumenfab profiles list`) or a file [default: {DEFAULT_PROFILE}]"))]
    pub(crate) profile: Option<String>,
}

/// Where it is printed.
#[derive(Debug, Args, Default)]
pub(crate) struct PrinterArgs {
    #[arg(long, value_name = "sim|PATH",
          help = format!("The printer's serial port, or `sim`: a simulated printer [default: the one a case was last printed on, else {SIMULATED_PORT}]"))]
    pub(crate) port: Option<String>,
}

#[derive(Debug, Args)]
#[command(group = ArgGroup::new("origin").args(["ct", "segmentation", "case"]).multiple(true))]
pub(crate) struct SegmentArgs {
    /// Case directory, to do the stage again; or a case file (TOML), to start the case that it describes or go on with it
    pub(crate) case: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) ct: CtArgs,
    #[command(flatten)]
    pub(crate) over: GivingUpArgs,
    /// Case directory to make [default for a case file: beside it, its name without .toml]
    #[arg(long, value_name = "CASE", requires = "origin")]
    pub(crate) out: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct SolidArgs {
    /// Case directory, to do the stage again
    #[arg(required_unless_present = "out", conflicts_with = "out")]
    pub(crate) case: Option<PathBuf>,
    /// Ready contours (sections.json): no CT is needed
    #[arg(long, value_name = "FILE", requires = "out")]
    pub(crate) sections: Option<PathBuf>,
    /// Case directory to make
    #[arg(long, value_name = "CASE", requires = "sections")]
    pub(crate) out: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) body: BodyArgs,
    #[command(flatten)]
    pub(crate) over: GivingUpArgs,
    /// Draw which contour continues which, and why, as SVG
    #[arg(long, value_name = "F.svg")]
    pub(crate) matching: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) view: ViewArgs,
}

/// A picture of the solid.
#[derive(Debug, Args)]
pub(crate) struct ViewArgs {
    /// Draw the solid shaded, as PNG
    #[arg(long, value_name = "F.png")]
    pub(crate) view: Option<PathBuf>,
    /// Where the picture is taken from, as the patient sees it; may be given more than once: tiles side by side
    /// [default: front, left and oblique]
    #[arg(long, requires = "view", value_parser = named(Direction::ALL.map(|d| (d.name(), d))))]
    pub(crate) from: Vec<Direction>,
    /// Height of the picture, pixels, 200 to 4000
    #[arg(long, value_name = "N", requires = "view", default_value_t = 1200,
          value_parser = clap::value_parser!(u32).range(200..=4000))]
    pub(crate) size_px: u32,
    /// What the surfaces are coloured by
    #[arg(long, requires = "view", default_value = "none", value_parser = colouring())]
    pub(crate) colour: Colouring,
    /// Cut the body open, so that the lumen is seen
    #[arg(long, requires = "view")]
    pub(crate) cut: bool,
}

#[derive(Debug, Args)]
pub(crate) struct SliceArgs {
    /// Case directory; or a model that another program made (STL in millimetres, 3MF), which is only moved onto the bed
    #[arg(value_name = "CASE|MODEL.stl|MODEL.3mf")]
    pub(crate) case: PathBuf,
    #[command(flatten)]
    pub(crate) layer: LayerArgs,
    #[command(flatten)]
    pub(crate) over: GivingUpArgs,
    /// Write the G-code to this file (for a case: to it too)
    #[arg(long, value_name = "F.gcode")]
    pub(crate) out: Option<PathBuf>,
    /// Draw every layer, its beads to scale and coloured by kind, into this new or empty folder: PNG and SVG
    #[arg(long, value_name = "DIR")]
    pub(crate) preview: Option<PathBuf>,
    /// Contours along each skin of a model [default: the profile's]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub(crate) perimeters: Option<u32>,
    #[arg(long, value_name = "P", value_parser = infill_percent, allow_hyphen_values = true,
          help = format!("{} [default: the profile's]", range_help("Fill of a model between them", settings::INFILL_PERCENT)))]
    pub(crate) infill_percent: Option<f64>,
    /// Turn a model about an axis (x, y or z) by an angle in degrees before it is put onto the bed
    #[arg(long, value_name = "AXIS,DEG", value_parser = orient, allow_hyphen_values = true)]
    pub(crate) orient: Option<(Axis, f64)>,
}

#[derive(Debug, Args)]
pub(crate) struct PrintArgs {
    /// Case directory, or a file of G-code
    #[arg(value_name = "CASE|JOB.gcode")]
    pub(crate) what: PathBuf,
    #[command(flatten)]
    pub(crate) printer: PrinterArgs,
    /// Profile of the printer, for a file of G-code: a name or a file [default: the one in the job's head, else marlin]
    #[arg(long, value_name = "NAME|FILE")]
    pub(crate) profile: Option<String>,
    /// Rate of the serial port, 1/s, 1200 to 4000000 [default: the profile's]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(1200..=4_000_000))]
    pub(crate) baud: Option<u32>,
    /// Print from the beginning although the last print of the job broke off: the bed is free, and it is not to be resumed
    #[arg(long)]
    pub(crate) anew: bool,
    /// Print a file even where its beads lie beyond the profile's build space, as on machines whose origin is the bed's middle
    #[arg(long)]
    pub(crate) beyond_bed: bool,
}

#[derive(Debug, Args)]
pub(crate) struct ResumeArgs {
    /// Case directory, or the file of G-code that was printed
    #[arg(value_name = "CASE|JOB.gcode")]
    pub(crate) what: PathBuf,
    /// Port of the printer: a path, or usb:VENDOR:PRODUCT[:SERIAL] [default: where it was printed]
    #[arg(long, value_name = "PATH")]
    pub(crate) port: Option<String>,
    /// Profile of the printer: a name or a file [default: the one it was printed with]
    #[arg(long, value_name = "NAME|FILE")]
    pub(crate) profile: Option<String>,
    /// Rate of the serial port, 1/s, 1200 to 4000000 [default: the profile's]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(1200..=4_000_000))]
    pub(crate) baud: Option<u32>,
    /// Go on although the printer was reset: I have looked at the part, and nothing was moved
    #[arg(long)]
    pub(crate) after_reset: bool,
}

#[derive(Debug, Args)]
#[command(group = ArgGroup::new("which").required(true).args(["port", "state"]))]
pub(crate) struct SafeOffArgs {
    /// Port of the printer: a path, or usb:VENDOR:PRODUCT[:SERIAL]
    #[arg(long, value_name = "PATH")]
    pub(crate) port: Option<String>,
    /// All printers that a server with this state directory has left hot and that no next one takes up; none while a server lives
    #[arg(long, value_name = "DIR", conflicts_with_all = ["profile", "baud", "after_s"])]
    pub(crate) state: Option<PathBuf>,
    /// Keep watching until stopped: a print that waits for the next server goes cold after firmware.orphan_hold_s of its profile
    #[arg(long, requires = "state")]
    pub(crate) watch: bool,
    /// Profile of the printer: a name or a file
    #[arg(long, value_name = "NAME|FILE", default_value = DEFAULT_PROFILE)]
    pub(crate) profile: String,
    /// Rate of the serial port, 1/s, 1200 to 4000000 [default: the profile's]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(1200..=4_000_000))]
    pub(crate) baud: Option<u32>,
    /// Only after so long, s, 0 to 86400: until then a print may be resumed warm; a port that is in use then is left alone
    #[arg(long, value_name = "S", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=86_400))]
    pub(crate) after_s: u32,
}

#[derive(Debug, Args)]
#[command(group = ArgGroup::new("output").required(true).multiple(true))]
pub(crate) struct ExportArgs {
    /// Case directory
    pub(crate) case: PathBuf,
    /// Binary STL to write
    #[arg(long, value_name = "F", group = "output")]
    pub(crate) stl: Option<PathBuf>,
    /// 3MF to write: millimetres, one object a body
    #[arg(long = "3mf", value_name = "F", group = "output")]
    pub(crate) three_mf: Option<PathBuf>,
    /// STEP (AP242) to write: the exact surfaces
    #[arg(long, value_name = "F", group = "output")]
    pub(crate) step: Option<PathBuf>,
    /// Table of triangles against deflection to write (CSV); its plot is written beside it (.svg)
    #[arg(long, value_name = "F.csv", group = "output")]
    pub(crate) sweep: Option<PathBuf>,
    /// The printed body, or the lumen alone, closed by its caps
    #[arg(long, default_value = "all", value_parser = named([("all", Skin::All), ("lumen", Skin::Lumen)]))]
    pub(crate) skin: Skin,
    #[arg(long, value_name = "D", value_parser = deflection_mm, allow_hyphen_values = true, default_value = "0.01",
          help = range_help("Farthest that the surface may be from its triangles", settings::DEFLECTION_MM))]
    pub(crate) deflection_mm: f64,
    #[arg(long, value_name = "C", value_parser = deflection_relative, allow_hyphen_values = true,
          conflicts_with = "deflection_mm",
          help = range_help("The same as a fraction", settings::DEFLECTION_RELATIVE))]
    pub(crate) deflection_relative: Option<f64>,
    /// What the vertices of a 3MF are coloured by
    #[arg(long, requires = "three_mf", default_value = "none", value_parser = colouring())]
    pub(crate) colour: Colouring,
}

#[derive(Debug, Args)]
pub(crate) struct PhantomArgs {
    /// Folder to write, new or empty
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// The vessel
    #[arg(long, default_value = Kind::default().name(), value_parser = named(Kind::ALL.map(|k| (k.name(), k))))]
    pub(crate) kind: Kind,
    /// Whether its lumen is brighter or darker than its wall
    #[arg(long, default_value = "bright", value_parser = named([("bright", Contrast::Bright), ("dark", Contrast::Dark)]))]
    pub(crate) polarity: Contrast,
    #[arg(long, value_name = "N", value_parser = noise_hu, allow_hyphen_values = true,
          default_value_t = phantom::Params::default().noise_hu,
          help = range_help("Standard deviation of the noise", settings::NOISE_HU))]
    pub(crate) noise_hu: f64,
    /// Seed of the noise
    #[arg(long, value_name = "N", default_value_t = phantom::Params::default().seed)]
    pub(crate) noise_seed: u64,
    #[arg(long, value_name = "S", value_parser = |t: &str| settings::PSF_SIGMA_MM.parse(t), allow_hyphen_values = true,
          default_value_t = phantom::Params::default().psf_sigma_mm,
          help = range_help("Standard deviation of the blur in the plane", settings::PSF_SIGMA_MM))]
    pub(crate) psf_sigma_mm: f64,
    #[arg(long, value_name = "T", value_parser = |t: &str| settings::SLAB_MM.parse(t), allow_hyphen_values = true,
          default_value_t = phantom::Params::default().slab_mm,
          help = range_help("Thickness that a plane averages over", settings::SLAB_MM))]
    pub(crate) slab_mm: f64,
    #[arg(long, value_name = "P", value_parser = |t: &str| settings::PIXEL_MM.parse(t), allow_hyphen_values = true,
          default_value_t = phantom::Params::default().pixel_mm,
          help = range_help("Side of a pixel", settings::PIXEL_MM))]
    pub(crate) pixel_mm: f64,
    /// Pixels along each side of the image, 8 to 2048
    #[arg(long, value_name = "N", default_value = "512", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(8..=2048))]
    pub(crate) pixels: u32,
    #[arg(long, value_name = "D", value_parser = |t: &str| settings::PLANE_STEP_MM.parse(t), allow_hyphen_values = true,
          default_value_t = phantom::Params::default().plane_step_mm,
          help = range_help("Distance of the planes", settings::PLANE_STEP_MM))]
    pub(crate) plane_step_mm: f64,
    /// Number of planes, 2 to 2000
    #[arg(long, value_name = "N", default_value = "46", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(2..=2000))]
    pub(crate) planes: u32,
    #[arg(long, value_name = "A", value_parser = |t: &str| settings::TILT_DEG.parse(t), allow_hyphen_values = true,
          default_value_t = phantom::Params::default().tilt_deg,
          help = range_help("Tilt of the gantry: planes lean, positions advance along z", settings::TILT_DEG))]
    pub(crate) tilt_deg: f64,
}

#[derive(Debug, Subcommand)]
pub(crate) enum ProfilesCommand {
    /// Names of the built-in profiles
    List,
    /// All values of a profile
    Show {
        /// Name or file
        #[arg(value_name = "NAME|FILE")]
        profile: String,
    },
    /// Ask the printer on a port which firmware it has, and name the profile for it
    Detect {
        /// A path, or usb:VENDOR:PRODUCT[:SERIAL]
        #[arg(long, value_name = "PATH")]
        port: String,
        /// Rate of the serial port, 1/s, 1200 to 4000000 [default: 115200, then 250000]
        #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(1200..=4_000_000))]
        baud: Option<u32>,
    },
    /// Check profile files, or built-in profiles
    Check {
        /// Names or files [default: all built-in profiles]
        #[arg(value_name = "NAME|FILE")]
        profiles: Vec<String>,
    },
}

impl CtArgs {
    /// The first flag that holds for one patient's images alone.
    pub(crate) fn of_one_patient(&self) -> Option<&'static str> {
        let flags = [
            ("--ct", self.ct.is_some()),
            ("--segmentation", self.segmentation.is_some()),
            ("--label", self.label.is_some()),
            ("--series", self.series.is_some()),
            ("--seed-mm", self.seed_mm.iter().any(|seed| matches!(seed, Seed::Point(_)))),
        ];
        flags.into_iter().find_map(|(flag, is_given)| is_given.then_some(flag))
    }

    pub(crate) fn patch(&self) -> CaseFile {
        CaseFile {
            ct: self.ct.clone(),
            segmentation: self.segmentation.clone(),
            label: self.label.clone(),
            series: self.series.clone(),
            allow_gaps: self.allow_gaps,
            seed_mm: (!self.seed_mm.is_empty()).then(|| Seeds(self.seed_mm.clone())),
            window_hu: self.window_hu,
            polarity: self.polarity,
            on_leak: self.on_leak,
            boundary: self.boundary,
            z_mm: self.z_mm,
            ..CaseFile::default()
        }
    }
}

impl BodyArgs {
    pub(crate) fn patch(&self) -> CaseFile {
        CaseFile { wall_mm: self.wall_mm, cast: self.cast.then_some(true), ..CaseFile::default() }
    }
}

impl ViewArgs {
    pub(crate) fn wanted(&self) -> Option<View> {
        Some(View {
            file: self.view.clone()?,
            from: self.from.clone(),
            size_px: self.size_px,
            colouring: self.colour,
            is_cut: self.cut,
        })
    }
}

impl LayerArgs {
    pub(crate) fn patch(&self) -> CaseFile {
        CaseFile { layer_mm: self.layer_mm, profile: self.profile.clone(), ..CaseFile::default() }
    }
}

impl PrinterArgs {
    pub(crate) fn patch(&self) -> CaseFile {
        CaseFile { port: self.port.clone(), ..CaseFile::default() }
    }
}

impl RunArgs {
    pub(crate) fn patch(&self) -> CaseFile {
        self.ct.patch().over(self.body.patch()).over(self.layer.patch()).over(self.printer.patch())
    }
}

/// A refused command line as one line: the flag, what was found, what was expected.
pub(crate) fn usage_line(error: &clap::Error) -> String {
    use clap::error::{ContextKind, ContextValue, ErrorKind};
    let context = |kind| match error.get(kind) {
        Some(ContextValue::String(text)) => Some(text.as_str()),
        _ => None,
    };
    let fault = std::error::Error::source(error);
    if let (Some(argument), Some(fault)) = (context(ContextKind::InvalidArg), fault) {
        let flag = argument.split(' ').next().unwrap_or(argument);
        return format!("{flag}: {fault}");
    }
    if error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        let names = ProfilesCommand::augment_subcommands(clap::Command::default());
        let names: Vec<&str> = names.get_subcommands().map(clap::Command::get_name).collect();
        return format!(
            "profiles: found nothing behind it, expected one of {} (see --help)",
            names.join(", ")
        );
    }
    let text = error.to_string();
    let what = text.split("\n\n").next().unwrap_or(&text).trim_start_matches("error: ");
    let tip = text.split("\n\n").find_map(|p| p.trim_start().strip_prefix("tip: "));
    let joined: Vec<&str> =
        what.split_whitespace().chain(tip.into_iter().flat_map(str::split_whitespace)).collect();
    format!("{} (see --help)", joined.join(" "))
}

#[cfg(test)]
mod tests;
