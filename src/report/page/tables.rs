//! The vessel's measures, walls and amounts as tables of page and document.

use super::super::{Angles, Branch, BranchFigures, Division, Origin, Report, Stage, Stenosis, shown};
use serde::Serialize;

/// A table as it is shown.
#[derive(Serialize)]
pub(in super::super) struct Table {
    pub(in super::super) title: &'static str,
    /// What its figures are, and how they were taken.
    pub(in super::super) caption: &'static str,
    pub(in super::super) columns: Vec<Column>,
    pub(in super::super) rows: Vec<Vec<String>>,
}

/// A column: its head, its width in the document in points, and whether it holds words.
#[derive(Serialize)]
pub(in super::super) struct Column {
    pub(in super::super) head: &'static str,
    pub(in super::super) width: f32,
    pub(in super::super) is_text: bool,
}

const fn words(head: &'static str, width: f32) -> Column {
    Column { head, width, is_text: true }
}

const fn number(head: &'static str, width: f32) -> Column {
    Column { head, width, is_text: false }
}

/// All tables that have rows.
pub(super) fn all(report: &Report) -> Vec<Table> {
    let tables = [
        errors(report),
        diameters(report),
        course(report),
        divisions(report),
        wall(report),
        volumes(report),
        job(report),
    ];
    tables.into_iter().filter(|t| !t.rows.is_empty()).collect()
}

/// A figure and its uncertainty, as far as both are known.
fn sure(value: Option<f64>, uncertainty: Option<f64>, decimals: usize) -> String {
    let off = uncertainty.filter(|_| value.is_some());
    let off = off.map_or_else(String::new, |u| format!(" \u{b1} {u:.decimals$}"));
    format!("{}{off}", shown(value, decimals))
}

/// The same in a narrow column: what is uncertain goes to the next line.
pub(super) fn narrow(value: Option<f64>, uncertainty: Option<f64>, decimals: usize) -> String {
    sure(value, uncertainty, decimals).replace("\u{b1} ", "\u{b1}")
}

/// One row for every stage of every branch.
fn of_stages(report: &Report, row: impl Fn(&Branch, usize) -> Vec<String>) -> Vec<Vec<String>> {
    let row = &row;
    let branches = report.anatomy.branches.iter();
    branches.flat_map(|branch| (0..branch.stages.len()).map(move |i| row(branch, i))).collect()
}

/// What a stage of the vessel's measures is called before a reader.
fn step(report: &Report, stage: &str) -> String {
    if stage == "recorded" { report.origin.step().into() } else { stage.into() }
}

fn errors(report: &Report) -> Table {
    let row = |stage: Stage, own: &BranchFigures| {
        let (f, u) = (&own.figures, &own.figures.uncertainty);
        vec![
            own.branch.clone(),
            super::title(stage).into(),
            narrow(f.mean_mm, u.mean_mm, 3),
            narrow(f.rms_mm, u.rms_mm, 3),
            narrow(f.p95_mm, u.p95_mm, 3),
            narrow(f.max_mm, u.max_mm, 3),
            narrow(f.bias_mm, u.bias_mm, 3),
            narrow(f.dice, u.dice, 4),
            narrow(f.area_error_percent, u.area_error_percent, 2),
        ]
    };
    let of_branch = |branch: &Branch| {
        let of_stage = |stage: Stage| {
            report.block(stage).branches.iter().find(|b| b.branch == branch.name).map(|own| row(stage, own))
        };
        report.stages().filter_map(of_stage).collect::<Vec<_>>()
    };
    Table {
        title: "Error by branch",
        caption: "The figures of every step, branch by branch: the samples that lie nearest to the branch's contours. Distances in mm; Dice and area are those of the lumen. \u{b1}: standard uncertainty.",
        columns: vec![
            words("Branch", 50.0),
            words("Step", 72.0),
            number("Mean", 53.0),
            number("RMS", 53.0),
            number("95th pct.", 53.0),
            number("Max", 53.0),
            number("Bias", 53.0),
            number("Dice", 66.0),
            number("Area %", 54.0),
        ],
        rows: report.anatomy.branches.iter().flat_map(of_branch).collect(),
    }
}

fn diameters(report: &Report) -> Table {
    let row = |branch: &Branch, i: usize| {
        let stage = &branch.stages[i];
        let diameter = |value| sure(value, stage.diameter_uncertainty_mm, 3);
        vec![
            branch.name.clone(),
            format!("{} to {}", branch.planes[0], branch.planes[1]),
            step(report, stage.stage),
            sure(stage.lumen_area_mm2, stage.lumen_area_uncertainty_mm2, 2),
            diameter(stage.equivalent_diameter_mm),
            diameter(stage.minimum_diameter_mm),
            diameter(stage.maximum_diameter_mm),
        ]
    };
    Table {
        title: "Lumen",
        caption: "Mean area and mean equivalent diameter (of the circle of the same area), least minimum diameter (between parallel lines) and largest maximum diameter (of two points) of each branch, as each step has it. In the CT planes, exact on the outline's polygon. \u{b1}: standard uncertainty of the outline as this step has it.",
        columns: vec![
            words("Branch", 52.0),
            words("Planes", 46.0),
            words("Step", 52.0),
            number("Area mm\u{b2}", 78.0),
            number("Equivalent mm", 94.0),
            number("Minimum mm", 94.0),
            number("Maximum mm", 94.0),
        ],
        rows: of_stages(report, row),
    }
}

fn course(report: &Report) -> Table {
    let row = |branch: &Branch, i: usize| {
        let stage = &branch.stages[i];
        vec![
            branch.name.clone(),
            step(report, stage.stage),
            sure(stage.centreline.length_mm, stage.centreline.length_uncertainty_mm, 2),
            sure(stage.centreline.tortuosity, stage.centreline.tortuosity_uncertainty, 3),
            stenosis(&stage.stenosis),
        ]
    };
    Table {
        title: "Course and stenosis",
        caption: "Length of the centreline through the centroids of the CT planes (\u{b1}: half of what it changes when every second plane is left out), tortuosity (length by chord, less one), degree of stenosis by NASCET from minimum diameters and area stenosis of the same two places, where a normal segment lies beyond a narrowing.",
        columns: vec![
            words("Branch", 52.0),
            words("Step", 52.0),
            number("Length mm", 78.0),
            number("Tortuosity", 78.0),
            words("Stenosis", 251.0),
        ],
        rows: of_stages(report, row),
    }
}

fn stenosis(s: &Stenosis) -> String {
    match (s.stenosis_nascet_percent, s.stenosis_throat, s.stenosis_reference) {
        (Some(percent), Some(throat), Some(reference)) => format!(
            "NASCET {} %, area {} % (throat {:.2} mm at plane {}, reference {:.2} mm at planes {} to {})",
            sure(Some(percent), s.stenosis_uncertainty_percent, 1),
            sure(s.stenosis_area_percent, s.stenosis_area_uncertainty_percent, 1),
            throat.diameter_mm,
            throat.plane,
            reference.diameter_mm,
            reference.planes[0],
            reference.planes[1]
        ),
        _ => s.stenosis_reason.clone().unwrap_or_default(),
    }
}

fn divisions(report: &Report) -> Table {
    let row = |division: &Division, angles: &Angles| {
        let at = division.at_mm.map_or_else(
            || format!("between planes {} and {}", division.planes[0], division.planes[1]),
            |[x, y, z]| format!("x {x:.2}, y {y:.2}, z {z:.3} \u{b1} {:.3}", division.uncertainty_mm),
        );
        let turns: Vec<String> = angles.from_trunk_deg.iter().map(|a| shown(*a, 1)).collect();
        let off = angles.uncertainty_deg.map_or_else(String::new, |u| format!(" (each \u{b1} {u:.1})"));
        let between = sure(angles.between_deg, angles.uncertainty_deg, 1);
        vec![joined(division), at, step(report, angles.stage), between, format!("{}{off}", turns.join(", "))]
    };
    let divisions = report.anatomy.divisions.iter();
    Table {
        title: "Divisions",
        caption: "Where the section of the solid falls apart (stack frame, mm), and angles in degrees between the straight lines that fit the first 10 mm of each centreline best: the largest between two branches, and of each branch off the trunk. \u{b1}: scatter of the centroids about these lines, and what is uncertain of the centroids.",
        columns: vec![
            words("Division", 126.0),
            words("Place", 166.0),
            words("Step", 52.0),
            number("Between", 62.0),
            number("Off the trunk", 104.0),
        ],
        rows: divisions.flat_map(|d| d.angles.iter().map(move |a| row(d, a))).collect(),
    }
}

/// Which branches become which, upward.
fn joined(division: &Division) -> String {
    let (trunk, branches) = (division.trunk.as_str(), division.branches.join(", "));
    if division.kind == "junction" {
        format!("{branches} into {trunk}")
    } else {
        format!("{trunk} into {branches}")
    }
}

fn wall(report: &Report) -> Table {
    let rows = report.walls.iter().filter_map(|stage| {
        let wall = stage.overall?;
        let off = wall.uncertainty;
        let thickness = [
            (wall.mean_mm, off.mean_mm),
            (wall.min_mm, off.min_mm),
            (wall.p5_mm, off.p5_mm),
            (wall.max_mm, off.max_mm),
        ]
        .map(|(value, off)| sure(value, off, 3));
        let filled = sure(wall.filled_percent, off.filled_percent, 2);
        Some([vec![step(report, stage.stage)], thickness.into(), vec![filled]].concat())
    });
    Table {
        title: "Wall",
        caption: "Thickness in the CT planes: from places 0.1 mm apart along the lumen the exact distance to the outline of the whole part; where the wall stands obliquely to the planes that is more than its thickness in space, which the solid was built for and which the note on the wall tells. So the largest here may be far above the thickness asked for. Filled: material over all between the outlines.",
        columns: vec![
            words("Step", 71.0),
            number("Mean mm", 88.0),
            number("Least mm", 88.0),
            number("5 % below mm", 88.0),
            number("Largest mm", 88.0),
            number("Filled %", 88.0),
        ],
        rows: rows.collect(),
    }
}

fn volumes(report: &Report) -> Table {
    let caption = match report.origin {
        Origin::Recorded => {
            "Lumen: areas in the CT planes integrated by cubics; \u{b1}: half of what leaving out every second plane changes. Layers: area times height. Material: cross-section of the beads times length; recorded: the record's own volumes."
        }
        Origin::Commanded => {
            "Lumen: areas in the CT planes integrated by cubics; \u{b1}: half of what leaving out every second plane changes. Layers: area times height. Material: cross-section of the beads times length; commanded: the filament of the acknowledged lines."
        }
    };
    let amounts = &report.amounts;
    let lumen = amounts
        .lumen
        .iter()
        .map(|l| (format!("lumen, {}", step(report, l.stage)), l.volume_mm3, l.uncertainty_mm3));
    let others = [
        ("layers, ends beyond the CT planes included".to_owned(), amounts.layers_mm3),
        ("material, planned".to_owned(), amounts.planned_material_mm3),
        (
            format!("material, {}", report.origin.known().trim_start_matches("as ")),
            amounts.recorded_material_mm3,
        ),
    ];
    let others = others.into_iter().map(|(name, value)| (name, value, None));
    let known = lumen.chain(others).filter(|row| row.1.is_some());
    Table {
        title: "Volumes",
        caption,
        columns: vec![words("What", 260.0), number("mm\u{b3}", 130.0)],
        rows: known.map(|(name, value, off)| vec![name, sure(value, off, 1)]).collect(),
    }
}

fn job(report: &Report) -> Table {
    let job = &report.amounts.job;
    let minutes = |s: Option<f64>| shown(s.map(|s| s / 60.0), 1);
    let rows = [
        ("Time, min", minutes(job.planned_s), minutes(job.recorded_s)),
        ("Filament, mm", shown(job.planned_filament_mm, 1), shown(job.recorded_filament_mm, 1)),
    ];
    let is_known = job.planned_s.or(job.recorded_s).or(job.planned_filament_mm).or(job.recorded_filament_mm);
    let (caption, head) = match report.origin {
        Origin::Recorded => {
            ("Planned: by the job's own estimate. Recorded: by the printer, priming included.", "Recorded")
        }
        Origin::Commanded => (
            "Planned: by the job's own estimate. Commanded, not measured: the filament of the lines that the printer has acknowledged, and how long the host took to send them.",
            "Commanded",
        ),
    };
    Table {
        title: "Time and filament",
        caption,
        columns: vec![words("What", 180.0), number("Planned", 100.0), number(head, 100.0)],
        rows: is_known
            .into_iter()
            .flat_map(|_| rows.clone())
            .map(|(name, planned, recorded)| vec![name.to_owned(), planned, recorded])
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::{Job, build, testing::Case, testing::inputs};
    use super::*;
    use crate::progress::Task;
    use crate::report::Inputs;

    #[test]
    fn tables_have_a_cell_for_every_column_and_none_without_rows_is_shown() {
        let case = Case::new(7);
        let with_job = Job { planned_s: Some(90.0), ..Job::default() };
        let report = build(&Inputs { job: with_job, ..inputs(&case) }, &Task::quiet()).unwrap();
        let tables = all(&report);
        let titles: Vec<&str> = tables.iter().map(|t| t.title).collect();
        // A straight tube divides nowhere.
        let [errors, titles @ ..] = titles.as_slice() else { panic!("no tables") };
        assert_eq!(*errors, "Error by branch");
        assert_eq!(titles, ["Lumen", "Course and stenosis", "Wall", "Volumes", "Time and filament"]);
        for table in &tables {
            assert!(table.rows.iter().all(|row| row.len() == table.columns.len()), "{}", table.title);
            assert!(table.columns.iter().map(|c| c.width).sum::<f32>() <= 511.0, "{}", table.title);
        }
        assert_eq!(tables[5].rows[0], ["Time, min", "1.5", "\u{2013}"]);
        // Six steps of the one branch, each figure with its uncertainty.
        let errors = &tables[0].rows;
        assert_eq!(errors.len(), 6);
        assert!(
            errors.iter().all(|row| row[2..].iter().all(|cell| cell.contains(" \u{b1}0."))),
            "{errors:?}"
        );
        let image = &tables[1].rows[0];
        assert!(image[2] == "image" && image[5].contains(" \u{b1} 0.0"), "{image:?}");
        let quiet = build(&inputs(&case), &Task::quiet()).unwrap();
        assert!(all(&quiet).iter().all(|t| t.title != "Time and filament"));
    }

    #[test]
    fn an_uncertainty_stands_beside_what_is_known_alone() {
        assert_eq!(sure(Some(3.24159), Some(0.0042), 3), "3.242 \u{b1} 0.004");
        assert_eq!((sure(Some(2.0), None, 1), sure(None, Some(1.0), 1)), ("2.0".into(), "\u{2013}".into()));
    }
}
