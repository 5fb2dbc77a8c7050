//! What JPEG and JPEG-LS share: marker segments (ITU-T T.81 B.1.1) and the restart markers between intervals.

use super::Fault;

pub(super) const SOI: u8 = 0xd8;
pub(super) const EOI: u8 = 0xd9;
pub(super) const SOS: u8 = 0xda;
pub(super) const DQT: u8 = 0xdb;
pub(super) const DHT: u8 = 0xc4;
pub(super) const DRI: u8 = 0xdd;
const RST0: u8 = 0xd0;

/// Marker segments in the order in which they stand.
#[derive(Debug)]
pub(super) struct Segments<'a> {
    bytes: &'a [u8],
    position: usize,
}

impl<'a> Segments<'a> {
    /// Segments of an image that must begin with its mark.
    pub(super) fn of(bytes: &'a [u8]) -> Result<Self, Fault> {
        match bytes {
            [0xff, SOI, ..] => Ok(Self { bytes, position: 2 }),
            [] | [0xff] => Err(Fault::Truncated),
            _ => Err(Fault::Damaged("the compressed pixels do not begin with the mark of an image")),
        }
    }

    /// The next marker and the body of its segment, empty for markers that stand alone.
    pub(super) fn next(&mut self) -> Result<(u8, Fields<'a>), Fault> {
        let marker = self.marker()?;
        if marker == EOI {
            return Ok((marker, Fields(&[])));
        }
        let [high, low] = *self.rest().first_chunk().ok_or(Fault::Truncated)?;
        let length = usize::from(u16::from_be_bytes([high, low]));
        if length < 2 {
            return Err(Fault::Damaged("a segment of the compressed pixels has no length"));
        }
        let body = self.rest().get(2..length).ok_or(Fault::Truncated)?;
        self.position += length;
        Ok((marker, Fields(body)))
    }

    fn marker(&mut self) -> Result<u8, Fault> {
        let [0xff, second, ..] = *self.rest() else {
            let is_end = self.rest().len() < 2;
            return Err(if is_end { Fault::Truncated } else { Fault::Damaged("a marker is missing") });
        };
        self.position += 1;
        if second == 0xff {
            // Any number of fill bytes may stand before a marker.
            return self.marker_after_fill();
        }
        self.position += 1;
        Ok(second)
    }

    fn marker_after_fill(&mut self) -> Result<u8, Fault> {
        let n_fill = self.rest().iter().take_while(|&&b| b == 0xff).count();
        let marker = *self.rest().get(n_fill).ok_or(Fault::Truncated)?;
        self.position += n_fill + 1;
        Ok(marker)
    }

    /// What stands behind the last segment.
    pub(super) fn rest(&self) -> &'a [u8] {
        &self.bytes[self.position..]
    }
}

/// The body of a segment, read from its front.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    pub(super) fn take(&mut self, n: usize) -> Result<&'a [u8], Fault> {
        const SHORT: Fault = Fault::Damaged("a segment of the compressed pixels is too short");
        let (taken, rest) = self.0.split_at_checked(n).ok_or(SHORT)?;
        self.0 = rest;
        Ok(taken)
    }

    pub(super) fn byte(&mut self) -> Result<u8, Fault> {
        Ok(self.take(1)?[0])
    }

    pub(super) fn word(&mut self) -> Result<u16, Fault> {
        let bytes = self.take(2)?;
        Ok(u16::from_be_bytes([bytes[0], bytes[1]]))
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) const fn len(&self) -> usize {
        self.0.len()
    }
}

/// What follows the restart marker of that number, which must stand at the front, fill bytes aside.
pub(super) fn behind_restart(bytes: &[u8], number: usize) -> Result<&[u8], Fault> {
    let n_fill = bytes.iter().take_while(|&&b| b == 0xff).count();
    let Some(&marker) = bytes.get(n_fill) else { return Err(Fault::Truncated) };
    if n_fill == 0 || usize::from(marker) != usize::from(RST0) + number % 8 {
        return Err(Fault::Damaged("a restart marker is missing"));
    }
    Ok(&bytes[n_fill + 1..])
}
