//! The matching drawn like a map of an underground railway: one column per branch, planes from the bottom upward,
//! contours as stops, links as lines, what happens named beside it. SVG, no fonts needed but the viewer's own.

use super::matching::{EventNote, Matching, Place};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Distances, in px.
const COLUMN: f64 = 44.0;
const MOST_ROW: f64 = 18.0;
const LEAST_ROW: f64 = 5.0;
/// Rows beyond which they move together, and the height that the drawing then has.
const TALL: f64 = 1800.0;
const LEFT: f64 = 150.0;
const TOP: f64 = 64.0;
const NOTES: f64 = 460.0;
/// Least distance of two lines of text.
const LINE: f64 = 13.0;
/// Colours that are told apart by most eyes (Okabe & Ito, "Color universal design", 2008).
const COLOURS: [&str; 7] = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#555555"];

/// Draws a matching.
#[must_use]
pub fn svg(matching: &Matching) -> String {
    let map = Map::of(matching);
    let mut out = String::new();
    map.write(&mut out).expect("a string takes every line");
    out
}

struct Map<'a> {
    matching: &'a Matching,
    /// Column of each branch, from the left.
    column: BTreeMap<usize, usize>,
    row: f64,
}

impl<'a> Map<'a> {
    fn of(matching: &'a Matching) -> Self {
        let n_rows = matching.planes.len().max(2) as f64;
        let row = (TALL / n_rows).clamp(LEAST_ROW, MOST_ROW);
        Self { matching, column: columns(matching), row }
    }

    fn x(&self, place: Place) -> f64 {
        let contours = self.matching.planes.get(place.plane_entry).map(|p| &p.contours);
        let branch = contours.and_then(|c| c.get(place.contour_entry)).map(|c| c.branch);
        let column = branch.and_then(|b| self.column.get(&b)).copied().unwrap_or(0);
        LEFT + COLUMN * (column as f64 + 0.5)
    }

    fn y(&self, plane_entry: usize) -> f64 {
        let from_top = self.matching.planes.len().saturating_sub(1 + plane_entry);
        TOP + self.row * (from_top as f64 + 0.5)
    }

    fn colour(&self, place: Place) -> &'static str {
        let contours = self.matching.planes.get(place.plane_entry).map(|p| &p.contours);
        let branch = contours.and_then(|c| c.get(place.contour_entry)).map_or(0, |c| c.branch);
        COLOURS[branch % COLOURS.len()]
    }

    fn right(&self) -> f64 {
        LEFT + COLUMN * self.column.len().max(1) as f64
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        let height = self.row.mul_add(self.matching.planes.len() as f64, TOP + 24.0);
        let width = self.right() + NOTES;
        writeln!(
            out,
            r#"<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0}" height="{height:.0}" viewBox="0 0 {width:.0} {height:.0}" font-family="sans-serif" font-size="11">"#
        )?;
        writeln!(out, r#"<rect width="100%" height="100%" fill="white"/>"#)?;
        self.write_head(out)?;
        self.write_rows(out)?;
        self.write_links(out)?;
        self.write_stops(out)?;
        self.write_events(out)?;
        writeln!(out, "</svg>")
    }

    fn write_head(&self, out: &mut String) -> std::fmt::Result {
        writeln!(
            out,
            r##"<text x="12" y="20" font-size="14" font-weight="bold">Which contour continues which</text><text x="12" y="38" fill="#333">{}</text><text x="12" y="54" fill="#777">dot: contour; ring: hole; dashed row: computed, not measured; dotted red: looked at and kept apart</text>"##,
            self.matching.summary
        )
    }

    fn write_rows(&self, out: &mut String) -> std::fmt::Result {
        let mut last_label = f64::INFINITY;
        for (entry, plane) in self.matching.planes.iter().enumerate() {
            let y = self.y(entry);
            let dash = if plane.plane.is_none() { r#" stroke-dasharray="5 4""# } else { "" };
            let shade = if plane.plane.is_none() { "#999" } else { "#e4e4e4" };
            writeln!(
                out,
                r#"<line x1="{LEFT:.0}" y1="{y:.1}" x2="{:.1}" y2="{y:.1}" stroke="{shade}"{dash}/>"#,
                self.right()
            )?;
            if last_label - y < LINE && plane.plane.is_some() {
                continue;
            }
            last_label = y;
            let name = plane.plane.map_or_else(|| "virtual".to_owned(), |p| format!("plane {p}"));
            writeln!(
                out,
                r##"<text x="{:.0}" y="{:.1}" text-anchor="end" fill="#333">{name}, z {:.2} mm</text>"##,
                LEFT - 8.0,
                y + 4.0,
                plane.z_mm
            )?;
        }
        Ok(())
    }

    fn write_links(&self, out: &mut String) -> std::fmt::Result {
        for link in &self.matching.links {
            let [x0, x1] = [link.lower, link.upper].map(|p| self.x(p));
            let [y0, y1] = [link.lower, link.upper].map(|p| self.y(p.plane_entry));
            let middle = 0.5 * (y0 + y1);
            let style = if link.joined {
                let sideways = if x1 < x0 || x0 < x1 { link.upper } else { link.lower };
                format!(r#"stroke="{}" stroke-width="4" stroke-linecap="round""#, self.colour(sideways))
            } else {
                r##"stroke="#d00" stroke-width="1" stroke-dasharray="1 3""##.to_owned()
            };
            writeln!(
                out,
                r#"<path d="M{x0:.1} {y0:.1}C{x0:.1} {middle:.1} {x1:.1} {middle:.1} {x1:.1} {y1:.1}" fill="none" {style}><title>{}</title></path>"#,
                escaped(&link.text)
            )?;
        }
        Ok(())
    }

    fn write_stops(&self, out: &mut String) -> std::fmt::Result {
        for (plane_entry, plane) in self.matching.planes.iter().enumerate() {
            for (contour_entry, contour) in plane.contours.iter().enumerate() {
                let place = Place { plane_entry, contour_entry };
                let radius = (0.3 * self.row).clamp(1.5, 4.0);
                let number =
                    contour.contour.map_or_else(|| "computed".to_owned(), |c| format!("contour {c}"));
                let fill = if contour.hole { "white" } else { "#222" };
                writeln!(
                    out,
                    r##"<circle cx="{:.1}" cy="{:.1}" r="{radius:.1}" fill="{fill}" stroke="#222"><title>{number}, {:.2} mm2</title></circle>"##,
                    self.x(place),
                    self.y(plane_entry),
                    contour.area_mm2
                )?;
            }
        }
        Ok(())
    }

    /// What happens, from the top down, each beside its height; pushed down where lines would overlap.
    fn write_events(&self, out: &mut String) -> std::fmt::Result {
        let mut free = TOP;
        for event in self.matching.events.iter().rev() {
            let (x, y) = self.centre(event);
            let label_y = (y + 4.0).max(free);
            free = label_y + LINE;
            writeln!(
                out,
                r##"<path d="M{x:.1} {y:.1}m-5 0l5 -5l5 5l-5 5z" fill="white" stroke="#000"/><path d="M{:.1} {y:.1}L{:.1} {y:.1}L{:.1} {:.1}" fill="none" stroke="#aaa" stroke-width="0.7"/><text x="{:.1}" y="{label_y:.1}">{}</text>"##,
                x + 6.0,
                self.right(),
                self.right() + 14.0,
                label_y - 4.0,
                self.right() + 18.0,
                escaped(&event.text)
            )?;
        }
        Ok(())
    }

    fn centre(&self, event: &EventNote) -> (f64, f64) {
        let all = || event.lower.iter().chain(&event.upper);
        let mean_x = all().map(|p| self.x(*p)).sum::<f64>() / all().count().max(1) as f64;
        let y_of = |places: &[Place]| places.first().map(|p| self.y(p.plane_entry));
        let half = 0.5 * self.row;
        let y = match (y_of(&event.lower), y_of(&event.upper)) {
            (Some(a), Some(b)) => 0.5 * (a + b),
            (Some(a), None) => a - half,
            (None, Some(b)) => b + half,
            (None, None) => TOP,
        };
        (mean_x, y)
    }
}

/// Columns of the branches: along the direction in which they lie farthest apart, so that neighbours in the vessel are
/// neighbours on the map.
fn columns(matching: &Matching) -> BTreeMap<usize, usize> {
    let mut sums: BTreeMap<usize, (f64, f64, f64)> = BTreeMap::new();
    for contour in matching.planes.iter().flat_map(|p| &p.contours) {
        let [x, y] = contour.centroid_mm;
        let sum = sums.entry(contour.branch).or_default();
        *sum = (sum.0 + x, sum.1 + y, sum.2 + 1.0);
    }
    let middles: Vec<(usize, f64, f64)> =
        sums.into_iter().map(|(branch, (x, y, n))| (branch, x / n, y / n)).collect();
    let n = middles.len().max(1) as f64;
    let (mx, my) = middles.iter().fold((0.0, 0.0), |(a, b), m| (a + m.1 / n, b + m.2 / n));
    let (xx, xy, yy) = middles.iter().fold((0.0, 0.0, 0.0), |(xx, xy, yy), m| {
        let (dx, dy) = (m.1 - mx, m.2 - my);
        (dx.mul_add(dx, xx), dx.mul_add(dy, xy), dy.mul_add(dy, yy))
    });
    // The principal axis of the branches' middles.
    let (sin, cos) = (0.5 * (2.0 * xy).atan2(xx - yy)).sin_cos();
    let mut along: Vec<(usize, f64)> =
        middles.iter().map(|m| (m.0, (m.1 - mx).mul_add(cos, (m.2 - my) * sin))).collect();
    along.sort_by(|a, b| a.1.total_cmp(&b.1));
    along.into_iter().enumerate().map(|(column, (branch, _))| (branch, column)).collect()
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
