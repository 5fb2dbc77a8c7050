//! The report as a document for the record (PDF): what the page says and shows, without what only a screen can do.
//!
//! Planes are the pixels of the CT with vector lines over them, as in the page. The same report gives the same bytes: the only date
//! in it is the one that the report was given. It is no PDF/A: the fonts are not embedded.

use super::page::chart::Chart;
use super::page::{self, View};
use super::plate::{Grey, Line, Plate};
use super::{Error, INTENDED_USE, Picture, Report};
use pdf_writer::Name;
use pdf_writer::types::LineJoinStyle;
use sheet::{Book, Colour, Column, MARGIN, RULE, Style, Titled, WIDTH};

mod sheet;

const TITLE: &str = "Quality report of a lumen replica";
const GOOD: Colour = [20, 102, 47];
const BAD: Colour = [161, 22, 22];
const UNSURE: Colour = [138, 90, 0];
const RED: Colour = [255, 59, 48];
const GREEN: Colour = [64, 235, 110];
const BLUE: Colour = [38, 130, 255];
const AMBER: Colour = [255, 179, 0];
const VIOLET: Colour = [213, 128, 255];
const GROUND: Colour = [28, 28, 30];
const WHITE: Colour = [255, 255, 255];
/// Width of the text.
const TEXT: f32 = WIDTH - 2.0 * MARGIN;
/// Most height of a plane's picture, points: three stand above one another.
const PICTURE: f32 = 196.0;

/// The document.
///
/// # Errors
/// [`Error::Pdf`] where pixels cannot be packed, [`Error::Drawing`] where a picture cannot be encoded.
pub(super) fn document(report: &Report, view: &View) -> Result<Vec<u8>, Error> {
    let mut book = Book::new();
    summary(&mut book, view);
    stages(&mut book, view);
    charts(&mut book, &view.charts);
    maps(&mut book, view)?;
    pictures(&mut book, report, view)?;
    tables(&mut book, view);
    methods(&mut book, view);
    sign_off(&mut book);
    let footer = format!("{}. Not a medical device; see the last page.", view.running);
    Ok(book.finish(TITLE, &footer)?)
}

fn summary(book: &mut Book, view: &View) {
    book.skip(14.0);
    book.text(TITLE, [MARGIN, book.y()], Style::bold(19.0));
    book.skip(4.0);
    let lead = format!(
        "{} {} CT planes, {} printed layers. Image, solid, toolpath and {} material of the same plane are compared; the error is split by the step in which it arose.",
        view.body_text, view.n_planes, view.n_layers, view.deposited
    );
    book.paragraph(&lead, Style::soft(9.5));
    let about: Vec<String> = view.about.iter().map(|(name, value)| format!("{name}: {value}")).collect();
    book.skip(4.0);
    for pair in about.chunks(2) {
        book.paragraph(&pair.join(" \u{b7} "), Style::plain(9.0));
    }
    book.heading("Result");
    let colour = match (view.passed, view.is_measured) {
        (false, _) => BAD,
        (true, true) => GOOD,
        (true, false) => UNSURE,
    };
    book.paragraph(&view.verdict, Style { colour, ..Style::bold(11.0) });
    for failure in &view.failures {
        book.paragraph(&format!("\u{2022} {failure}"), Style { colour, ..Style::plain(9.5) });
    }
    if !(view.failures.is_empty() || view.not_judged.is_empty()) {
        book.paragraph("Not judged, for it is finer than can be told:", Style::plain(9.5));
    }
    for open in &view.not_judged {
        book.paragraph(&format!("\u{2022} {open}"), Style::plain(9.5));
    }
    book.skip(6.0);
    let columns = [(180.0, false), (90.0, true), (240.0, false)].map(column);
    let rows: Vec<Vec<String>> =
        view.cards.iter().map(|c| vec![c.label.clone(), c.value.clone(), format!("   {}", c.hint)]).collect();
    book.table(&columns, &["Figure", "Value", "Meaning"], &rows, 9.5);
    defects(book, view);
    book.heading("What to know before reading on");
    for note in &view.notes {
        book.paragraph(&format!("\u{2022} {} ({})", note.lead, note.code), Style::plain(9.0));
        for item in &note.items {
            book.paragraph(&format!("    \u{2013} {item}"), Style::plain(9.0));
        }
    }
}

fn defects(book: &mut Book, view: &View) {
    if view.defects.is_empty() {
        book.heading("What is wrong");
        book.paragraph("No defect was found in any step.", Style::plain(9.5));
    } else {
        let columns =
            [(78.0, false), (66.0, false), (120.0, false), (78.0, false), (169.0, false)].map(column);
        let row = |d: &page::defects::DefectRow| {
            let what = if d.standing == page::defects::FAILS {
                d.what.to_owned()
            } else {
                format!("{} ({})", d.what, d.standing)
            };
            vec![what, d.step.to_owned(), d.place.clone(), d.size.clone(), d.text.clone()]
        };
        let rows: Vec<Vec<String>> = view.defects.iter().map(row).collect();
        let head = ["What", "Step", "Where", "How much", "In words"];
        book.section(&Titled { title: "What is wrong", caption: "" }, &columns, &head, &rows, 8.0);
    }
    book.skip(4.0);
    book.paragraph("What this comparison cannot see:", Style::soft(8.5));
    for limit in view.not_seen {
        book.paragraph(&format!("\u{2022} {limit}"), Style::soft(8.5));
    }
}

fn column((width, right): (f32, bool)) -> Column {
    Column { width, right }
}

fn stages(book: &mut Book, view: &View) {
    let caption = format!(
        "All planes together. Distances in mm, curve to curve, both ways; bias: positive where the later step lies outside the earlier one; \u{b1}: standard uncertainty. In the deposition step, Dice and area are those of the {} material over all layers.",
        view.deposited
    );
    let mut columns = vec![column((78.0, false)), column((161.0, false))];
    columns.extend([column((39.0, true)); 7]);
    let row = |s: &page::StageRow| -> Vec<String> {
        let compared =
            s.reason.as_ref().map_or_else(|| s.meaning.to_owned(), |r| format!("{}: {r}", s.meaning));
        let mut row = vec![s.name.to_owned(), compared];
        row.extend([&s.mean, &s.rms, &s.p95, &s.max, &s.bias, &s.dice, &s.area].map(Clone::clone));
        row
    };
    let rows: Vec<Vec<String>> = view.stages.iter().map(row).collect();
    let head = ["Step", "Compared", "Mean", "RMS", "95th p.", "Max", "Bias", "Dice", "Area %"];
    book.section(&Titled { title: "Where the error arose", caption: &caption }, &columns, &head, &rows, 8.5);
}

fn charts(book: &mut Book, charts: &[Chart]) {
    for chart in charts {
        let scale = TEXT.min(420.0) / narrow(chart.width);
        let height = scale * narrow(chart.height);
        book.need(height + 30.0);
        book.skip(20.0);
        book.text(chart.title, [MARGIN, book.y()], Style::bold(9.5));
        book.skip(4.0);
        draw_chart(book, chart, scale);
        book.skip(height);
    }
}

#[expect(clippy::cast_possible_truncation, reason = "places on a page")]
const fn narrow(value: f64) -> f32 {
    value as f32
}

/// A colour of a chart: `#1f5fa8`.
fn of_hex(text: &str) -> Colour {
    let channel = |i: usize| text.get(i..i + 2).and_then(|t| u8::from_str_radix(t, 16).ok()).unwrap_or(0);
    [channel(1), channel(3), channel(5)]
}

fn draw_chart(book: &mut Book, chart: &Chart, scale: f32) {
    let origin = [MARGIN, book.y()];
    book.within(origin, scale, |book| {
        let content = book.content();
        stroke_colour(content, RULE);
        for line in &chart.grid {
            let [x0, y0, x1, y1] = [line.x0, line.y0, line.x1, line.y1].map(narrow);
            content.set_line_width(0.8).move_to(x0, y0).line_to(x1, y1).stroke();
        }
        for bar in &chart.bars {
            fill_colour(content, of_hex(bar.colour));
            let [x, y, width, height] = [bar.x, bar.y, bar.width, bar.height].map(narrow);
            content.rect(x, y, width, height).fill_nonzero();
        }
        for curve in &chart.curves {
            stroke_colour(content, of_hex(curve.colour));
            let dash: Vec<f32> =
                curve.dash.iter().flat_map(|d| d.split(' ')).filter_map(|n| n.parse().ok()).collect();
            content.set_line_width(2.0).set_dash_pattern(dash, 0.0);
            for (i, point) in curve.points.split(' ').enumerate() {
                let mut place = point.split(',').filter_map(|n| n.parse::<f32>().ok());
                let (Some(x), Some(y)) = (place.next(), place.next()) else { continue };
                if i == 0 {
                    content.move_to(x, y)
                } else {
                    content.line_to(x, y)
                };
            }
            content.stroke();
        }
    });
    for label in &chart.labels {
        let style = Style { colour: label.colour.map_or(sheet::BLACK, of_hex), ..Style::plain(11.0 * scale) };
        let shift = match label.anchor {
            "end" => style.width(&label.text),
            "middle" => 0.5 * style.width(&label.text),
            _ => 0.0,
        };
        let [x, y] = [label.x, label.y].map(|v| narrow(v) * scale);
        book.text(&label.text, [origin[0] + x - shift, origin[1] + y], style);
    }
}

fn fill_colour(content: &mut pdf_writer::Content, colour: Colour) {
    let [r, g, b] = colour.map(|c| f32::from(c) / 255.0);
    content.set_fill_rgb(r, g, b);
}

fn stroke_colour(content: &mut pdf_writer::Content, colour: Colour) {
    let [r, g, b] = colour.map(|c| f32::from(c) / 255.0);
    content.set_stroke_rgb(r, g, b);
}

fn maps(book: &mut Book, view: &View) -> Result<(), Error> {
    let is_empty = view.map_groups.iter().all(|g| g.maps.is_empty());
    if is_empty {
        return Ok(());
    }
    book.need(320.0);
    book.heading("Deviation around and along the vessel");
    book.paragraph(
        &format!(
            "Each branch cut open and laid flat: around it from left to right, along its centreline upward. Blue: the lumen is too narrow (full colour at -{0} mm), red: too wide (+{0} mm), grey: not known. The {1} lumen lies against the boundary in the image (of the contours, where there is none){2}.",
            view.most_mm,
            view.deposited,
            if view.is_commanded { "; it is commanded, not measured" } else { "" }
        ),
        Style::soft(8.5),
    );
    for group in &view.map_groups {
        if let Some(title) = &group.title {
            book.need(200.0);
            book.skip(16.0);
            book.text(title, [MARGIN, book.y()], Style::bold(9.5));
        }
        map_rows(book, &group.maps)?;
    }
    Ok(())
}

fn map_rows(book: &mut Book, maps: &[page::Map]) -> Result<(), Error> {
    const SCALE: f32 = 0.62;
    const PITCH: f32 = 168.0;
    for row in maps.chunks(3) {
        let height = row.iter().map(|m| narrow(m.height)).fold(0.0, f32::max) * SCALE + 42.0;
        book.need(height);
        let top = book.y() + 16.0;
        for (i, map) in row.iter().enumerate() {
            let x = MARGIN + PITCH * i as f32;
            let title = format!("{}, {} mm", map.name, map.length);
            book.text(&title, [x, top], Style::bold(9.0));
            let picture = book.picture(&map.pixels, map.n_cols, map.pixels.len() / (3 * map.n_cols))?;
            let [width, height] = [map.width, map.height].map(narrow);
            book.within([x, top + 5.0], SCALE, |book| book.draw_picture(picture, [0.0, 0.0, width, height]));
            for (j, side) in map.sides.iter().enumerate() {
                let at = x + SCALE * width * j as f32 / 4.0 - 2.5;
                book.text(side, [at, top + 14.0 + SCALE * height], Style::plain(8.0));
            }
        }
        book.skip(height);
    }
    Ok(())
}

fn pictures(book: &mut Book, report: &Report, view: &View) -> Result<(), Error> {
    let Some(first) = report.pictures.first() else { return Ok(()) };
    book.new_page();
    book.heading("Pictures of all planes");
    let caption = format!(
        "CT in grey, segmented boundary dashed green, section of the solid red, planned toolpaths blue, material {} amber{}.",
        view.known,
        if view.has_scan { ", scanned replica violet" } else { "" }
    );
    book.paragraph(&caption, Style::soft(8.5));
    book.skip(6.0);
    let [width, height] = first.plate.size.map(|s| narrow(f64::from(s)));
    let scale = (0.48 * TEXT / width).min(PICTURE / height);
    let below = scale * height + 30.0;
    for (pair, views) in report.pictures.chunks(2).zip(view.planes.chunks(2)) {
        book.need(below);
        for (i, (picture, plane)) in pair.iter().zip(views).enumerate() {
            let at = [MARGIN + 0.52 * TEXT * i as f32, book.y()];
            draw_plane(book, picture, at, scale)?;
            let y = at[1] + scale * height + 10.0;
            book.text(&plane.name(), [at[0], y], Style::bold(8.0));
            book.text(&plane.summary(), [at[0], y + 9.5], Style::soft(7.5));
        }
        book.skip(below);
    }
    Ok(())
}

fn draw_plane(book: &mut Book, picture: &Picture, at: [f32; 2], scale: f32) -> Result<(), Error> {
    let plate = &picture.plate;
    let grey = plate.grey.as_ref().map(|g| Ok::<_, Error>((g, book.picture(&shown(g), g.n_cols, g.n_rows)?)));
    let grey = grey.transpose()?;
    let [width, height] = plate.size.map(|s| narrow(f64::from(s)));
    book.within(at, scale, |book| {
        fill_colour(book.content(), GROUND);
        book.content().rect(0.0, 0.0, width, height).fill_nonzero();
        book.content().rect(0.0, 0.0, width, height).clip_nonzero().end_path();
        if let Some((grey, id)) = grey {
            book.draw_picture(id, grey.place.map(narrow));
        }
        draw_lines(book, plate, 1.0 / scale);
    });
    signs(book, plate, at, [scale * width, scale * height], scale);
    Ok(())
}

/// The pixels within the shown window.
fn shown(grey: &Grey) -> Vec<u8> {
    let ([low, high], [black, white]) = (grey.range_hu, grey.window_hu);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
    let level = |byte: u8| {
        let hu = low + (high - low) * f64::from(byte) / 255.0;
        (255.0 * (hu - black) / (white - black)).round().clamp(0.0, 255.0) as u8
    };
    grey.values.iter().map(|&byte| level(byte)).collect()
}

/// `point` is the length of a point in units.
fn draw_lines(book: &mut Book, plate: &Plate, point: f32) {
    let content = book.content();
    content.set_line_join(LineJoinStyle::RoundJoin);
    content.save_state().set_parameters(Name(b"T"));
    fill_colour(content, AMBER);
    trace(content, &plate.material, true);
    content.fill_even_odd().restore_state();
    for (lines, closed, colour, width) in [
        (&plate.paths, false, BLUE, 0.35),
        (&plate.solid, true, RED, 0.8),
        (&plate.contours, true, GREEN, 0.5),
        (&plate.scan, true, VIOLET, 0.5),
    ] {
        stroke_colour(content, colour);
        let dash = if std::ptr::eq(lines, &raw const plate.contours) {
            vec![2.5 * point, 2.0 * point]
        } else {
            Vec::new()
        };
        content.set_line_width(width * point).set_dash_pattern(dash, 0.0);
        trace(content, lines, closed);
        content.stroke();
    }
}

fn trace(content: &mut pdf_writer::Content, lines: &[Line], closed: bool) {
    for line in lines {
        for (i, p) in line.iter().enumerate() {
            let [x, y] = p.map(|v| narrow(f64::from(v)));
            if i == 0 {
                content.move_to(x, y)
            } else {
                content.line_to(x, y)
            };
        }
        if closed {
            content.close_path();
        }
    }
}

/// Letters of the sides, and a bar that shows a length.
fn signs(book: &mut Book, plate: &Plate, [x, y]: [f32; 2], [width, height]: [f32; 2], scale: f32) {
    let style = Style { colour: WHITE, ..Style::bold(8.0) };
    let bar = page::Bar::of(plate.size);
    let [x0, x1, bar_y] = [bar.x0, bar.x1, bar.y].map(|v| narrow(v) * scale);
    book.within([x, y], 1.0, |book| {
        let content = book.content();
        stroke_colour(content, WHITE);
        content.set_dash_pattern([], 0.0).set_line_width(1.2).move_to(x0, bar_y).line_to(x1, bar_y).stroke();
    });
    book.text(&bar.text, [x + x0, y + bar_y - 3.0], Style { bold: false, ..style });
    let [left, right, top, bottom, ..] = plate.sides;
    book.text(left, [x + 3.0, y + 0.5 * height], style);
    book.text(right, [x + width - 9.0, y + 0.5 * height], style);
    book.text(top, [x + 0.5 * width, y + 9.0], style);
    book.text(bottom, [x + 0.5 * width, y + height - 3.0], style);
}

fn tables(book: &mut Book, view: &View) {
    book.new_page();
    let caption = format!(
        "Total: boundary in the image against {} material. The columns on the right give the mean distance of each step. mm; the IoU is that of the material of the plane's layer.",
        view.deposited
    );
    let mut columns = vec![column((30.0, true)), column((40.0, true))];
    let (n_figures, width) = if view.has_scan { (13, 33.7) } else { (12, 36.5) };
    columns.extend(vec![column((width, true)); n_figures]);
    let row = |p: &page::PlaneView| -> Vec<String> {
        [p.plane.to_string(), p.z.clone()].into_iter().chain(p.cells.iter().cloned()).collect()
    };
    let rows: Vec<Vec<String>> = view.planes.iter().map(row).collect();
    let head = [
        "Plane", "z", "Mean", "95th p.", "Max", "Bias", "Dice", "Area %", "Segm.", "Recon.", "Slicing",
        "Toolp.", "Depos.", "IoU", "Scan",
    ];
    let titled = Titled { title: "Figures of every plane", caption: &caption };
    book.section(&titled, &columns, &head[..columns.len()], &rows, 7.5);
    for table in &view.tables {
        let columns: Vec<Column> = table.columns.iter().map(|c| column((c.width, !c.is_text))).collect();
        let head: Vec<&str> = table.columns.iter().map(|c| c.head).collect();
        let titled = Titled { title: table.title, caption: table.caption };
        book.section(&titled, &columns, &head, &table.rows, 8.0);
    }
}

fn methods(book: &mut Book, view: &View) {
    book.heading("How it was measured");
    for method in &view.methods {
        book.skip(4.0);
        book.paragraph(method.name, Style::bold(9.0));
        book.paragraph(method.text, Style::plain(8.5));
    }
    book.heading("Intended use");
    book.paragraph(INTENDED_USE, Style::plain(9.0));
}

fn sign_off(book: &mut Book) {
    book.need(150.0);
    book.heading("Sign-off");
    for line in ["Released for the intended use (yes / no), remarks:", "Name, function:", "Date, signature:"]
    {
        book.skip(30.0);
        book.text(line, [MARGIN, book.y()], Style::plain(9.0));
        book.skip(4.0);
        book.rule();
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::Case;
    use super::super::{Inputs, build, testing::inputs};
    use super::*;
    use crate::progress::Task;

    fn pdf(report: &Report) -> Result<Vec<u8>, Error> {
        document(report, &page::view(report)?)
    }

    fn count(file: &[u8], what: &str) -> usize {
        file.windows(what.len()).filter(|w| *w == what.as_bytes()).count()
    }

    #[test]
    fn every_plane_is_in_it_and_the_same_report_gives_the_same_bytes() {
        let report = build(&inputs(&Case::new(7)), &Task::quiet()).unwrap();
        let file = pdf(&report).unwrap();
        assert!(file.starts_with(b"%PDF-") && file.ends_with(b"%%EOF"));
        assert_eq!(count(&file, "/DeviceGray"), 7);
        assert_eq!(count(&file, "/DeviceRGB"), 1);
        assert!(file == pdf(&report).unwrap());
    }

    #[test]
    fn a_case_without_a_ct_has_its_document_too() {
        let case = Case::new(2);
        let report = build(&Inputs { image: None, ..inputs(&case) }, &Task::quiet()).unwrap();
        assert_eq!(count(&pdf(&report).unwrap(), "/DeviceGray"), 0);
    }

    #[test]
    fn colours_of_charts_are_read() {
        assert_eq!(of_hex("#1f5fa8"), [0x1f, 0x5f, 0xa8]);
    }
}
