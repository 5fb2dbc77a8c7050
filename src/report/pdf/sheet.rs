//! Pages of a PDF: text that wraps, tables, lines, pictures. Places are in points from the upper left corner of an A4 page.
//!
//! The fonts are Helvetica and its bold face, which every reader of PDF has; nothing is embedded. Letters beyond Latin-1
//! (Windows code page 1252) become question marks.

use flate2::Compression;
use flate2::write::ZlibEncoder;
use pdf_writer::{Content, Filter, Finish, Name, Pdf, Rect, Ref, Str, TextStr};
use std::io::Write;

pub(super) const WIDTH: f32 = 595.0;
const HEIGHT: f32 = 842.0;
/// Free space around a page.
pub(super) const MARGIN: f32 = 42.0;
/// Where the footer begins.
const BOTTOM: f32 = HEIGHT - 52.0;

const CATALOG: Ref = Ref::new(1);
const PAGE_TREE: Ref = Ref::new(2);
const INFO: Ref = Ref::new(3);
const PLAIN: Ref = Ref::new(4);
const BOLD: Ref = Ref::new(5);
const TRANSLUCENT: Ref = Ref::new(6);
const FIRST_FREE: i32 = 7;

pub(super) type Colour = [u8; 3];
pub(super) const BLACK: Colour = [22, 32, 42];
pub(super) const SOFT: Colour = [77, 91, 104];
pub(super) const RULE: Colour = [190, 199, 207];

/// Widths of the letters from space to tilde in Helvetica, thousandths of the size (Adobe font metrics).
#[rustfmt::skip]
const WIDTHS: [u16; 95] = [
    278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278,
    556, 556, 556, 556, 556, 556, 556, 556, 556, 556, 278, 278, 584, 584, 584, 556,
    1015, 667, 667, 722, 722, 667, 611, 778, 722, 278, 500, 667, 556, 833, 722, 778,
    667, 778, 722, 667, 611, 722, 667, 944, 667, 667, 611, 278, 278, 278, 469, 556,
    333, 556, 556, 500, 556, 556, 278, 556, 556, 222, 222, 500, 222, 833, 556, 556,
    556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334, 260, 334, 584,
];

/// How a text is set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Style {
    pub(super) size: f32,
    pub(super) bold: bool,
    pub(super) colour: Colour,
}

impl Style {
    pub(super) const fn plain(size: f32) -> Self {
        Self { size, bold: false, colour: BLACK }
    }

    pub(super) const fn bold(size: f32) -> Self {
        Self { size, bold: true, colour: BLACK }
    }

    pub(super) const fn soft(size: f32) -> Self {
        Self { size, bold: false, colour: SOFT }
    }

    /// How wide a text is; the bold face is taken as a twentieth wider.
    pub(super) fn width(self, text: &str) -> f32 {
        let of =
            |byte: u8| byte.checked_sub(32).and_then(|i| WIDTHS.get(usize::from(i))).copied().unwrap_or(556);
        let sum: f32 = encoded(text).into_iter().map(|b| f32::from(of(b))).sum();
        sum / 1000.0 * self.size * if self.bold { 1.05 } else { 1.0 }
    }

    fn leading(self) -> f32 {
        1.35 * self.size
    }

    /// The text in lines of at most `width`; a longer word stands alone.
    fn wrapped(self, text: &str, width: f32) -> Vec<String> {
        let mut lines = vec![String::new()];
        for word in text.split_whitespace() {
            let line = lines.last_mut().map_or_else(String::new, std::mem::take);
            let longer = if line.is_empty() { word.to_owned() } else { format!("{line} {word}") };
            if line.is_empty() || self.width(&longer) <= width {
                lines.pop();
                lines.push(longer);
            } else {
                lines.pop();
                lines.extend([line, word.to_owned()]);
            }
        }
        lines
    }
}

/// Text in Windows code page 1252.
fn encoded(text: &str) -> Vec<u8> {
    let byte = |c: char| match c {
        '\u{2013}' => 0x96,
        '\u{2014}' => 0x97,
        '\u{2019}' => 0x92,
        '\u{2022}' => 0x95,
        '\u{2212}' => b'-',
        c => u8::try_from(u32::from(c)).unwrap_or(b'?'),
    };
    text.chars().map(byte).collect()
}

/// A column of a table.
#[derive(Debug, Clone, Copy)]
pub(super) struct Column {
    pub(super) width: f32,
    pub(super) right: bool,
}

/// What stands above a table.
#[derive(Debug, Clone, Copy)]
pub(super) struct Titled<'a> {
    pub(super) title: &'a str,
    /// Nothing, or what the figures are.
    pub(super) caption: &'a str,
}

struct Sheet {
    content: Content,
    pictures: Vec<Ref>,
}

impl Sheet {
    fn new() -> Self {
        Self { content: Content::new(), pictures: Vec::new() }
    }
}

/// Pages one after the other.
pub(super) struct Book {
    pdf: Pdf,
    next: i32,
    sheets: Vec<Sheet>,
    sheet: Sheet,
    /// Where the next thing goes.
    y: f32,
}

impl Book {
    pub(super) fn new() -> Self {
        Self { pdf: Pdf::new(), next: FIRST_FREE, sheets: Vec::new(), sheet: Sheet::new(), y: MARGIN }
    }

    pub(super) fn y(&self) -> f32 {
        self.y
    }

    pub(super) fn skip(&mut self, height: f32) {
        self.y += height;
    }

    pub(super) fn new_page(&mut self) {
        self.sheets.push(std::mem::replace(&mut self.sheet, Sheet::new()));
        self.y = MARGIN;
    }

    /// Goes to the next page where less than `height` is left.
    pub(super) fn need(&mut self, height: f32) {
        if self.y + height > BOTTOM && self.y > MARGIN {
            self.new_page();
        }
    }

    /// What is drawn directly, in the coordinates of PDF (upward).
    pub(super) fn content(&mut self) -> &mut Content {
        &mut self.sheet.content
    }

    /// Draws within a box whose upper left corner is the origin and whose y runs downward, `scale` points a unit.
    pub(super) fn within(&mut self, [x, y]: [f32; 2], scale: f32, draw: impl FnOnce(&mut Self)) {
        self.sheet.content.save_state().transform([scale, 0.0, 0.0, -scale, x, HEIGHT - y]);
        draw(self);
        self.sheet.content.restore_state();
    }

    /// A line of text whose base line is at `y`.
    pub(super) fn text(&mut self, text: &str, [x, y]: [f32; 2], style: Style) {
        let [r, g, b] = style.colour.map(|c| f32::from(c) / 255.0);
        let font = if style.bold { Name(b"B") } else { Name(b"P") };
        self.sheet
            .content
            .begin_text()
            .set_fill_rgb(r, g, b)
            .set_font(font, style.size)
            .set_text_matrix([1.0, 0.0, 0.0, 1.0, x, HEIGHT - y])
            .show(Str(&encoded(text)))
            .end_text();
    }

    pub(super) fn heading(&mut self, text: &str) {
        self.need(60.0);
        self.skip(20.0);
        self.text(text, [MARGIN, self.y], Style::bold(12.5));
        self.skip(8.0);
    }

    /// Lines of text as wide as the page allows.
    pub(super) fn paragraph(&mut self, text: &str, style: Style) {
        for line in style.wrapped(text, WIDTH - 2.0 * MARGIN) {
            self.need(style.leading());
            self.skip(style.leading());
            self.text(&line, [MARGIN, self.y], style);
        }
    }

    pub(super) fn rule(&mut self) {
        let [r, g, b] = RULE.map(|c| f32::from(c) / 255.0);
        let y = HEIGHT - self.y;
        let content = &mut self.sheet.content;
        content
            .set_stroke_rgb(r, g, b)
            .set_line_width(0.5)
            .move_to(MARGIN, y)
            .line_to(WIDTH - MARGIN, y)
            .stroke();
    }

    /// A table under its heading: whole on a page where it is short, never parted from its first rows.
    pub(super) fn section(
        &mut self,
        titled: &Titled<'_>,
        columns: &[Column],
        head: &[&str],
        rows: &[Vec<String>],
        size: f32,
    ) {
        const SHORT: f32 = 260.0;
        let caption = Style::soft(8.5);
        let lines = if titled.caption.is_empty() {
            0
        } else {
            caption.wrapped(titled.caption, WIDTH - 2.0 * MARGIN).len()
        };
        let above = 32.0 + caption.leading() * lines as f32 + Style::bold(size).leading() + 3.5;
        let heights: Vec<f32> = rows.iter().map(|row| row_height(columns, row, Style::plain(size))).collect();
        let (whole, first) = (heights.iter().sum::<f32>(), heights.iter().take(2).sum::<f32>());
        self.need(above + if whole <= SHORT { whole } else { first });
        self.heading(titled.title);
        if lines > 0 {
            self.paragraph(titled.caption, caption);
            self.skip(4.0);
        }
        self.table(columns, head, rows, size);
    }

    /// A table, its head on every page; its last row is not left alone.
    pub(super) fn table(&mut self, columns: &[Column], head: &[&str], rows: &[Vec<String>], size: f32) {
        let head: Vec<String> = head.iter().map(|&h| h.to_owned()).collect();
        self.need(50.0);
        self.row(columns, &head, Style::bold(size));
        let height_of = |row: &Vec<String>| row_height(columns, row, Style::plain(size));
        for (i, row) in rows.iter().enumerate() {
            let next = if i + 2 == rows.len() { height_of(&rows[i + 1]) } else { 0.0 };
            let height = height_of(row) + next;
            if self.y + height > BOTTOM {
                self.new_page();
                self.row(columns, &head, Style::bold(size));
            }
            self.row(columns, row, Style::plain(size));
        }
    }

    fn row(&mut self, columns: &[Column], cells: &[String], style: Style) {
        let (top, mut x) = (self.y, MARGIN);
        for (column, cell) in columns.iter().zip(cells) {
            for (i, line) in style.wrapped(cell, column.width - 5.0).iter().enumerate() {
                let shift = if column.right { column.width - 5.0 - style.width(line) } else { 0.0 };
                let y = top + style.leading() * (i as f32 + 1.0);
                self.text(line, [x + shift, y], style);
            }
            x += column.width;
        }
        self.y = top + row_height(columns, cells, style);
        self.rule();
    }

    /// Keeps pixels, row by row, three bytes each or one; to be drawn by [`Self::draw_picture`].
    pub(super) fn picture(&mut self, pixels: &[u8], n_cols: usize, n_rows: usize) -> std::io::Result<Ref> {
        let data = deflated(pixels)?;
        let id = self.free();
        let mut image = self.pdf.image_xobject(id, &data);
        image.filter(Filter::FlateDecode);
        image.bits_per_component(8);
        image
            .width(i32::try_from(n_cols).unwrap_or(i32::MAX))
            .height(i32::try_from(n_rows).unwrap_or(i32::MAX));
        if pixels.len() == n_cols * n_rows {
            image.interpolate(true).color_space().device_gray();
        } else {
            image.color_space().device_rgb();
        }
        Ok(id)
    }

    /// Draws a picture into a box within [`Self::within`]: left, top, width, height.
    pub(super) fn draw_picture(&mut self, picture: Ref, [x, y, width, height]: [f32; 4]) {
        self.sheet.pictures.push(picture);
        let name = picture_name(picture);
        self.sheet
            .content
            .save_state()
            .transform([width, 0.0, 0.0, -height, x, y + height])
            .x_object(Name(name.as_bytes()))
            .restore_state();
    }

    fn free(&mut self) -> Ref {
        self.next += 1;
        Ref::new(self.next - 1)
    }

    /// The file. `footer` stands on every page, beside its number.
    pub(super) fn finish(mut self, title: &str, footer: &str) -> std::io::Result<Vec<u8>> {
        self.new_page();
        let n_pages = self.sheets.len();
        let mut pages = Vec::with_capacity(n_pages);
        for (i, sheet) in std::mem::take(&mut self.sheets).into_iter().enumerate() {
            self.sheet = sheet;
            let number = format!("page {} of {n_pages}", i + 1);
            let style = Style::soft(7.5);
            let (y, x) = (HEIGHT - 28.0, WIDTH - MARGIN - style.width(&number));
            for (j, line) in style.wrapped(footer, x - MARGIN - 12.0).iter().enumerate() {
                self.text(line, [MARGIN, y + style.leading() * j as f32], style);
            }
            self.text(&number, [x, y], style);
            let sheet = std::mem::replace(&mut self.sheet, Sheet::new());
            pages.push(self.page(sheet)?);
        }
        self.pdf.catalog(CATALOG).pages(PAGE_TREE).lang(TextStr("en"));
        self.pdf.pages(PAGE_TREE).count(i32::try_from(n_pages).unwrap_or(i32::MAX)).kids(pages);
        self.pdf.document_info(INFO).title(TextStr(title)).producer(TextStr("lumenfab"));
        for (id, name) in [(PLAIN, b"Helvetica".as_slice()), (BOLD, b"Helvetica-Bold")] {
            self.pdf.type1_font(id).base_font(Name(name)).encoding_predefined(Name(b"WinAnsiEncoding"));
        }
        self.pdf.ext_graphics(TRANSLUCENT).non_stroking_alpha(0.33);
        Ok(self.pdf.finish())
    }

    fn page(&mut self, sheet: Sheet) -> std::io::Result<Ref> {
        let (id, content) = (self.free(), self.free());
        let data = deflated(&sheet.content.finish())?;
        self.pdf.stream(content, &data).filter(Filter::FlateDecode);
        let mut page = self.pdf.page(id);
        page.parent(PAGE_TREE).media_box(Rect::new(0.0, 0.0, WIDTH, HEIGHT)).contents(content);
        let mut resources = page.resources();
        resources.fonts().pair(Name(b"P"), PLAIN).pair(Name(b"B"), BOLD);
        resources.ext_g_states().pair(Name(b"T"), TRANSLUCENT);
        let mut pictures = resources.x_objects();
        for picture in sheet.pictures {
            pictures.pair(Name(picture_name(picture).as_bytes()), picture);
        }
        pictures.finish();
        resources.finish();
        page.finish();
        Ok(id)
    }
}

fn row_height(columns: &[Column], cells: &[String], style: Style) -> f32 {
    let lines = columns.iter().zip(cells).map(|(c, cell)| style.wrapped(cell, c.width - 5.0).len());
    style.leading() * lines.max().unwrap_or(1) as f32 + 3.5
}

fn picture_name(id: Ref) -> String {
    format!("X{}", id.get())
}

fn deflated(bytes: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes)?;
    encoder.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_wraps_at_words_and_keeps_them_all() {
        let style = Style::plain(10.0);
        // Ten digits of 5.56 points.
        assert!((style.width("0123456789") - 55.6).abs() < 1e-3);
        let lines = style.wrapped("aaa bbb  ccc\nddddddddddddddddddddd e", 45.0);
        assert_eq!(lines, ["aaa bbb", "ccc", "ddddddddddddddddddddd", "e"]);
        assert_eq!(style.wrapped("", 45.0), [""]);
    }

    #[test]
    fn letters_have_their_place_in_the_code_page() {
        assert_eq!(encoded("a\u{b2}\u{2013}\u{2300}"), [b'a', 0xb2, 0x96, b'?']);
    }

    #[test]
    fn a_heading_stays_with_its_table_and_no_row_stands_alone() {
        let columns = [Column { width: 100.0, right: false }; 2];
        let rows = |n: i32| -> Vec<Vec<String>> { (0..n).map(|i| vec![i.to_string(), "x".into()]).collect() };
        let titled = Titled { title: "title", caption: "caption" };
        let mut book = Book::new();
        book.skip(620.0);
        book.section(&titled, &columns, &["number", "letter"], &rows(9), 9.0);
        assert_eq!(book.sheets.len(), 1, "a short table goes to the next page as a whole");
        // One row more than a page takes.
        let row = row_height(&columns, &rows(1)[0], Style::plain(9.0));
        #[expect(clippy::cast_possible_truncation, reason = "rows of a page")]
        let n_fit = ((BOTTOM - MARGIN) / row) as i32 - 1;
        let mut book = Book::new();
        book.table(&columns, &["number", "letter"], &rows(n_fit + 1), 9.0);
        assert_eq!(book.sheets.len(), 1);
        assert!(book.y() > MARGIN + 2.5 * row, "the last row has the one before it and the head");
    }

    #[test]
    fn a_table_that_is_too_long_goes_on_with_its_head() {
        let mut book = Book::new();
        let columns = [Column { width: 100.0, right: false }; 2];
        let rows: Vec<Vec<String>> = (0..90).map(|i| vec![i.to_string(), "x".into()]).collect();
        book.table(&columns, &["number", "letter"], &rows, 9.0);
        assert_eq!(book.sheets.len(), 1);
        let file = book.finish("t", "f").unwrap();
        assert!(file.starts_with(b"%PDF-") && file.windows(8).any(|w| w == b"/Count 2"));
    }
}
