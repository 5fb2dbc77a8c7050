//! From a CT series of a blood vessel to a printed replica of its lumen, with proof of how faithful it is.
//!
//! # The data's way
//!
//! ```text
//!  DICOM, NIfTI, ... ─ ct ─▶ Volume ─ segment ─▶ Mask ─ sections ─▶ SectionStack ◀─ ready ─ label map, SEG, RTSTRUCT
//!                                                          │ topology, spline
//!  report ◀─ beads ◀─ hil-sim ◀─ printer ◀─ gcode ◀─ toolpath ◀─ slice ◀─ solid ─▶ mesh (STL, 3MF), brep (STEP)
//!     ▲                                                                    │
//!     └──────────── Volume, SectionStack, Solid, layers, job ──────────────┘
//! ```
//!
//! # The rooms
//!
//! | module | what it does |
//! |---|---|
//! | [`units`] | the newtypes where a swap would hurt; the only conversions |
//! | [`progress`] | progress reports and cancellation for long work |
//! | [`geom`] | points, contours, regions and their boolean operations, frames, distances |
//! | [`ct`] | a folder of DICOM files, or an image file, to a [`ct::Volume`] |
//! | [`phantom`] | analytic vessels and their synthetic CT series |
//! | [`segment`] | a volume to the mask of its lumen |
//! | [`sections`] | mask and grey values to closed sub-pixel contours per CT plane |
//! | [`ready`] | segmentations made elsewhere to contours per plane |
//! | [`spline`] | knot vectors, B-spline curves and surfaces, interpolation |
//! | [`topology`] | which contour continues which: branches, splits, merges, births, deaths, holes |
//! | [`solid`] | the surfaces of lumen and wall, and their exact sections |
//! | [`mesh`] | tessellation, what is wrong with a mesh, STL and 3MF |
//! | [`model`] | meshes that other programs made: read, welded, put into one order |
//! | [`brep`] | vertices, edges, faces and shells of a solid; whether it is valid |
//! | [`step`] | a boundary representation as a STEP file |
//! | [`draw`] | lines, letters and scale bars on pictures |
//! | [`view`] | a mesh to a shaded picture |
//! | [`mod@slice`] | layers on the CT-aligned grid, or from a foreign mesh |
//! | [`toolpath`] | layers to beads and travels |
//! | [`preview`] | beads of a layer to a picture and to SVG |
//! | [`profile`] | firmware and machine profiles, as data |
//! | [`gcode`] | commands, writer, reader, checksum |
//! | [`motion`] | acceleration model: how long a job takes; whether it keeps within the build space |
//! | [`printer`] | the protocol core and the session (pure), journal and resuming, links, the driver |
//! | [`queue`] | states of jobs, claims, beds, history, schedule (pure) |
//! | [`store`] | where the queue is kept: SQLite |
//! | [`http`] | faces of the queue: the own API, the part of OctoPrint's that slicers use, keys, events, sockets |
//! | [`client`] | the other side of `http`: typed calls, events |
//! | [`report`] | slice-against-CT distances, pictures, pages |
//! | [`app`] | the use cases: cases, stages, the whole run |
//! | [`appliance`] | the server: printing, preparing, supervision, state directory, configuration |
//! | [`tui`] | the terminal UI, a face of `client` |
//! | [`cli`] | the command line, a face of `app` |
//!
//! # Invariants
//!
//! - A stage knows the types of earlier stages, [`geom`] and [`units`]; nothing later.
//! - The pure modules read no clock, file, environment or random source. IO lives in `ct::reader`, `ready`,
//!   `phantom::series`, `profile::load`, `printer::{ask, device, driver, job, journal::writer, paper, serial, sim}`,
//!   `report::write`, `store`, `http::{files, keys, metrics, serve, upload}`, `client`, `tui::{edge, link}`, `appliance`, `app` and `cli`.
//! - Lengths are millimetres in `f64` unless the name says otherwise; frames are named in transforms as
//!   `stack_from_patient`, `bed_from_stack`.
//! - Outer contours run counter-clockwise seen from +z, holes clockwise.
//! - Same input and parameters, same bytes out, on any number of threads.
//! - Nothing that identifies a patient leaves [`ct`] and [`ready`]; names of structures are for the terminal alone.

pub mod app;
pub mod appliance;
pub mod brep;
pub mod cli;
pub mod client;
pub mod ct;
pub mod draw;
pub mod gcode;
pub mod geom;
pub mod http;
pub mod mesh;
pub mod model;
pub mod motion;
mod nearest;
pub mod phantom;
pub mod preview;
pub mod printer;
pub mod profile;
pub mod progress;
pub mod queue;
pub mod ready;
pub mod report;
pub mod sections;
pub mod segment;
pub mod slice;
pub mod solid;
pub mod spline;
pub mod step;
pub mod store;
pub mod toolpath;
pub mod topology;
pub mod tui;
pub mod units;
pub mod view;
