//! The figures of every CT plane as a table for other programs (CSV, RFC 4180): one row a plane, dot as decimal mark, an empty
//! field where a figure is not known, units in the names of the columns. Columns `scan_...` come last, where there is a scan of the replica.

use super::deviation::Figures;
use super::{Report, Stage};
use std::fmt::Write;

type Figure = (&'static str, fn(&Figures) -> Option<f64>);

/// What is told of each step.
const FIGURES: [Figure; 7] = [
    ("mean_mm", |f| f.mean_mm),
    ("rms_mm", |f| f.rms_mm),
    ("p95_mm", |f| f.p95_mm),
    ("max_mm", |f| f.max_mm),
    ("bias_mm", |f| f.bias_mm),
    ("dice", |f| f.dice),
    ("area_error_percent", |f| f.area_error_percent),
];

/// The table, a line of names first.
#[must_use]
pub fn csv(report: &Report) -> String {
    let mut names: Vec<String> = ["plane", "z_mm", "layer"].map(str::to_owned).into();
    for stage in Stage::ALL {
        names.extend(FIGURES.map(|(figure, _)| format!("{}_{figure}", stage.name())));
    }
    names.push("deposition_iou".into());
    if report.scan.is_some() {
        names.extend(FIGURES.map(|(figure, _)| format!("{}_{figure}", Stage::Scan.name())));
    }
    let mut text = names.join(",") + "\r\n";
    for (k, z_mm) in report.plane_z_mm.iter().enumerate() {
        let layer = report.layers.iter().find(|l| l.ct_plane == Some(k));
        let mut fields =
            vec![k.to_string(), z_mm.to_string(), layer.map_or_else(String::new, |l| l.layer.to_string())];
        let figures_of = |stage: Stage| {
            let figures = report.block(stage).planes.get(k).map(|p| p.figures).unwrap_or_default();
            FIGURES.map(|(_, of)| field(of(&figures)))
        };
        fields.extend(Stage::ALL.into_iter().flat_map(figures_of));
        fields.push(field(report.block(Stage::Deposition).planes.get(k).and_then(|p| p.iou)));
        if report.scan.is_some() {
            fields.extend(figures_of(Stage::Scan));
        }
        if write!(text, "{}\r\n", fields.join(",")).is_err() {
            break;
        }
    }
    text
}

/// To 10^-6, as in `report.json`.
fn field(value: Option<f64>) -> String {
    value.map_or_else(String::new, |v| ((v * 1e6).round() / 1e6 + 0.0).to_string())
}

#[cfg(test)]
mod tests {
    use super::super::testing::Case;
    use super::super::{Inputs, build, testing::inputs};
    use super::*;
    use crate::progress::Task;

    #[test]
    fn every_plane_has_a_row_with_the_figures_of_the_json() {
        let report = build(&inputs(&Case::new(3)), &Task::quiet()).unwrap();
        let json: serde_json::Value = serde_json::from_str(&report.to_json().unwrap()).unwrap();
        let text = csv(&report);
        let rows: Vec<Vec<&str>> = text.split_terminator("\r\n").map(|l| l.split(',').collect()).collect();
        assert!(rows.len() == 4 && rows.iter().all(|row| row.len() == rows[0].len()));
        for (column, name) in rows[0].iter().enumerate().skip(3) {
            let (stage, figure) = name.split_once('_').unwrap();
            for k in 0..3 {
                let expected = json[stage]["planes"][k][figure].as_f64().unwrap();
                assert_eq!(rows[k + 1][column].parse::<f64>().unwrap(), expected, "{name} of plane {k}");
            }
        }
        assert_eq!(rows[2][..3], ["1", "3", "22"]);
    }

    #[test]
    fn what_is_not_known_is_left_empty() {
        let case = Case::new(2);
        let report = build(&Inputs { image: None, ..inputs(&case) }, &Task::quiet()).unwrap();
        let text = csv(&report);
        let column = text.lines().next().unwrap().split(',').position(|n| n == "total_mean_mm").unwrap();
        assert!(text.lines().skip(1).all(|l| l.split(',').nth(column) == Some("")));
    }
}
