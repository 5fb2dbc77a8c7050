//! A picture of one layer of a record.
//!
//! Beads of `beads.csv` are drawn from above as rectangles of their recorded width, blue on white, x to the right and y up;
//! where they overlap, the colour is deeper. Grey lines every 10 mm of the bed show where the layer lies and how large it is.
//! Layers are found as the recorder finds them, from the heights in the order of
//! the rows.

use crate::{
    Error,
    deposit::Layers,
    record::{BEADS_FILE, BEADS_HEADER},
    whole,
};
use std::{
    fs::File,
    io::{BufRead, BufReader, BufWriter},
    path::Path,
};

/// Width of the picture where no pixel size is given, pixels.
const DEFAULT_PIXELS: f64 = 1000.0;
/// Largest side of a picture, pixels.
const MOST_PIXELS: f64 = 8192.0;
/// White space around the layer, mm.
const MARGIN_MM: f64 = 1.0;
/// What one bead leaves of the light, red, green, blue.
const TINT: [f64; 3] = [0.35, 0.55, 0.9];

/// Distance of the bed's grid lines, mm, and what they leave of the light.
const GRID_MM: f64 = 10.0;
const GRID_LIGHT: f64 = 0.85;

/// A bead from above.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stroke {
    from: [f64; 2],
    to: [f64; 2],
    width: f64,
}

impl Stroke {
    /// Signed distance of a point from the edge of the rectangle, negative inside.
    fn distance(&self, point: [f64; 2]) -> f64 {
        let along = [self.to[0] - self.from[0], self.to[1] - self.from[1]];
        let length = along[0].hypot(along[1]).max(1e-9);
        let unit = along.map(|c| c / length);
        let from_middle =
            [point[0] - (self.from[0] + self.to[0]) / 2.0, point[1] - (self.from[1] + self.to[1]) / 2.0];
        let u = from_middle[0].mul_add(unit[0], from_middle[1] * unit[1]).abs() - length / 2.0;
        let v = from_middle[1].mul_add(unit[0], -from_middle[0] * unit[1]).abs() - self.width / 2.0;
        u.max(0.0).hypot(v.max(0.0)) + u.max(v).min(0.0)
    }

    fn bounds(&self) -> [f64; 4] {
        let reach = self.width / 2.0;
        [
            self.from[0].min(self.to[0]) - reach,
            self.from[1].min(self.to[1]) - reach,
            self.from[0].max(self.to[0]) + reach,
            self.from[1].max(self.to[1]) + reach,
        ]
    }
}

/// Draws layer `layer` (from 0) of the record in `dir` into the PNG file `out`.
///
/// # Errors
/// [`Error::Io`], [`Error::Beads`] for a table that is not of its form, [`Error::NoLayer`], [`Error::Option`] for a
/// pixel size that is not above 0.
pub fn draw_file(dir: &Path, layer: usize, out: &Path, pixel_mm: Option<f64>) -> Result<(), Error> {
    if pixel_mm.is_some_and(|size| !(size.is_finite() && size > 0.0)) {
        let problem = "a size above 0 is expected".to_owned();
        return Err(Error::Option { option: "--pixel-mm".to_owned(), problem });
    }
    let path = dir.join(BEADS_FILE);
    let file = File::open(&path).map_err(|error| Error::io("read", &path, error))?;
    let strokes = read_layer(BufReader::new(file), &path, layer)?;
    write_png(&draw(&strokes, pixel_mm, GRID_LIGHT), out)
}

/// The beads of one layer.
fn read_layer(table: impl BufRead, path: &Path, layer: usize) -> Result<Vec<Stroke>, Error> {
    let mut layers = Layers::default();
    let mut strokes = Vec::new();
    for (index, text) in table.lines().enumerate() {
        let text = text.map_err(|error| Error::io("read", path, error))?;
        let wrong = |problem: String| Error::Beads { path: path.to_owned(), line: index + 1, problem };
        if index == 0 {
            if text != BEADS_HEADER {
                return Err(wrong(format!("the header `{BEADS_HEADER}` is expected")));
            }
            continue;
        }
        let row = read_row(&text).map_err(wrong)?;
        layers.visit(row[6]);
        if layers.current() == Some(layer) {
            strokes.push(Stroke { from: [row[1], row[2]], to: [row[4], row[5]], width: row[8] });
        }
    }
    if strokes.is_empty() {
        return Err(Error::NoLayer { path: path.to_owned(), layer, n_layers: layers.count() });
    }
    Ok(strokes)
}

fn read_row(text: &str) -> Result<[f64; 11], String> {
    let mut row = [0.0; 11];
    let mut fields = text.split(',');
    for value in &mut row {
        let field = fields.next().ok_or("11 numbers are expected")?;
        *value = field
            .parse()
            .ok()
            .filter(|x: &f64| x.is_finite())
            .ok_or_else(|| format!("`{field}` is no number"))?;
    }
    if fields.next().is_some() { Err("11 numbers are expected".to_owned()) } else { Ok(row) }
}

/// Rows of red, green, blue bytes from the top.
struct Picture {
    size: [usize; 2],
    rgb: Vec<u8>,
}

fn draw(strokes: &[Stroke], pixel_mm: Option<f64>, grid_light: f64) -> Picture {
    let start = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    let bounds = strokes
        .iter()
        .map(Stroke::bounds)
        .fold(start, |a, b| [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]);
    let corner = [bounds[0] - MARGIN_MM, bounds[3] + MARGIN_MM];
    let extent = [bounds[2] + MARGIN_MM - corner[0], corner[1] - bounds[1] + MARGIN_MM];
    let longest = extent[0].max(extent[1]);
    let pixel = pixel_mm.unwrap_or(longest / DEFAULT_PIXELS).max(longest / MOST_PIXELS);
    let size = extent.map(|mm| whole::floor_to_usize((mm / pixel).ceil()).max(1));
    let mut light = grid(size, corner, pixel, grid_light);
    for stroke in strokes {
        shade(&mut light, size, stroke, corner, pixel);
    }
    Picture { size, rgb: light.iter().map(|light| whole::to_u8(light * 255.0)).collect() }
}

/// The empty bed.
fn grid(size: [usize; 2], corner: [f64; 2], pixel: f64, grid_light: f64) -> Vec<f64> {
    let is_line = |mm: f64| (mm - (mm / GRID_MM).round() * GRID_MM).abs() <= pixel / 2.0;
    let columns: Vec<bool> =
        (0..size[0]).map(|i| is_line((i as f64 + 0.5).mul_add(pixel, corner[0]))).collect();
    let mut light = Vec::with_capacity(size[0] * size[1] * 3);
    for j in 0..size[1] {
        let row = is_line((j as f64 + 0.5).mul_add(-pixel, corner[1]));
        for column in &columns {
            light.extend([if row || *column { grid_light } else { 1.0 }; 3]);
        }
    }
    light
}

fn shade(light: &mut [f64], size: [usize; 2], stroke: &Stroke, corner: [f64; 2], pixel: f64) {
    let [x0, y0, x1, y1] = stroke.bounds();
    let column = |x: f64| whole::floor_to_usize((x - corner[0]) / pixel);
    let row = |y: f64| whole::floor_to_usize((corner[1] - y) / pixel);
    for j in row(y1).saturating_sub(1)..(row(y0) + 2).min(size[1]) {
        for i in column(x0).saturating_sub(1)..(column(x1) + 2).min(size[0]) {
            let centre =
                [(i as f64 + 0.5).mul_add(pixel, corner[0]), (j as f64 + 0.5).mul_add(-pixel, corner[1])];
            let cover = (0.5 - stroke.distance(centre) / pixel).clamp(0.0, 1.0);
            for (channel, tint) in light[(j * size[0] + i) * 3..][..3].iter_mut().zip(TINT) {
                *channel *= cover.mul_add(tint - 1.0, 1.0);
            }
        }
    }
}

fn write_png(picture: &Picture, out: &Path) -> Result<(), Error> {
    let file = File::create(out).map_err(|error| Error::io("create", out, error))?;
    let [width, height] =
        picture.size.map(|n| u32::try_from(n).expect("a picture is at most 8192 pixels wide"));
    let mut encoder = png::Encoder::new(BufWriter::new(file), width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder
        .write_header()
        .and_then(|mut writer| {
            writer.write_image_data(&picture.rgb)?;
            writer.finish()
        })
        .map_err(|error| Error::io("write", out, std::io::Error::other(error)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROWS: &str = "0,10,10,0.2,20,10,0.2,0.8,0.4,0.2,200\n0,10,10,0.4,10,20,0.4,0.8,0.4,0.2,200\n";

    fn read(rows: &str, layer: usize) -> Result<Vec<Stroke>, String> {
        let table = format!("{BEADS_HEADER}\n{rows}");
        read_layer(table.as_bytes(), Path::new("beads.csv"), layer).map_err(|error| error.to_string())
    }

    #[test]
    fn layer_is_found_by_its_height() {
        assert_eq!(read(ROWS, 1).unwrap(), [Stroke { from: [10.0, 10.0], to: [10.0, 20.0], width: 0.4 }]);
        assert!(read(ROWS, 2).unwrap_err().contains("there is no layer 2; the record has 2"));
    }

    #[test]
    fn damaged_tables_name_the_line() {
        assert!(read("1,2,3\n", 0).unwrap_err().contains("line 2: 11 numbers"));
        assert!(read("1,2,3,x,5,6,7,8,9,10,11\n", 0).unwrap_err().contains("`x` is no number"));
        let error = read_layer(&b"a,b\n"[..], Path::new("b.csv"), 0).unwrap_err().to_string();
        assert!(error.contains("b.csv line 1: the header"), "{error}");
    }

    #[test]
    fn drawn_area_is_length_times_width() {
        let picture = draw(&[Stroke { from: [0.0, 0.0], to: [8.0, 6.0], width: 2.0 }], Some(0.05), 1.0);
        let dark: f64 =
            picture.rgb.chunks(3).map(|rgb| (255.0 - f64::from(rgb[0])) / (255.0 * (1.0 - TINT[0]))).sum();
        assert!((dark * 0.05 * 0.05 / 20.0 - 1.0).abs() < 0.005, "{}", dark * 0.0025);
    }

    #[test]
    fn grid_lies_on_the_bed_s_tens() {
        // From x = 7 mm on: there is a line at 10 mm.
        let picture = draw(&[Stroke { from: [8.0, 20.5], to: [12.0, 20.5], width: 0.1 }], Some(0.1), 0.5);
        let grey = |i: usize, j: usize| picture.rgb[(j * picture.size[0] + i) * 3];
        // 3 mm from the left.
        assert!((28..=32).any(|i| grey(i, 0) < 200), "no line at x = 10");
        assert_eq!(grey(5, 0), 255);
    }

    #[test]
    fn picture_is_written() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join(BEADS_FILE), format!("{BEADS_HEADER}\n{ROWS}")).unwrap();
        let out = dir.path().join("layer.png");
        draw_file(dir.path(), 0, &out, None).unwrap();
        assert!(std::fs::read(&out).unwrap().starts_with(b"\x89PNG"));
        assert_eq!(draw_file(dir.path(), 9, &out, None).unwrap_err().exit_code(), 2);
        assert_eq!(draw_file(dir.path(), 0, &out, Some(0.0)).unwrap_err().exit_code(), 2);
    }
}
