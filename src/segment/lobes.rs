//! A region of one plane as lobes: what is left when it is cut at its narrow necks.
//!
//! The distance to the outside (exact, in mm: Felzenszwalb and Huttenlocher, "Distance transforms of sampled
//! functions", Theory of Computing 8, 2012) has a peak in the middle of every bulge and a saddle in every neck.
//! Pixels are taken in the order of falling distance; where two bulges meet at a saddle much lower than both
//! peaks, they stay apart and the neck is kept with its width: a watershed whose only parameter is how narrow a
//! neck is against what it joins, so that it holds for vessels of any size.

/// A neck is narrow below this part of the smaller bulge's width: two discs of equal size that overlap by less
/// than a fifth of their diameter are two.
const NARROW: f64 = 0.6;
/// Bulges of a smaller radius than this, in pixels, are the staircase of the pixels.
const LEAST_PEAK_PIXELS: f64 = 1.5;
/// No lobe: outside the region.
pub(super) const NO_LOBE: u32 = u32::MAX;

/// A bulge of the region.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lobe {
    /// How many pixels it has.
    pub(super) n_pixels: usize,
    /// Radius of the largest disc in it, mm.
    pub(super) radius_mm: f64,
    /// Index of the pixel in that disc's middle.
    pub(super) at: usize,
}

/// A narrow passage between two lobes of a plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Neck {
    /// The two lobes.
    pub(super) lobes: [u32; 2],
    /// How wide it is, mm.
    pub(super) width_mm: f64,
    /// Index of the pixel in its middle.
    pub(super) at: usize,
}

/// A plane's region cut into lobes.
#[derive(Debug, Clone, Default)]
pub(super) struct Lobes {
    /// The lobe of every pixel, or [`NO_LOBE`].
    pub(super) labels: Vec<u32>,
    /// Distance of every pixel of the region to the nearest one outside, less half a pixel, mm.
    pub(super) depth_mm: Vec<f32>,
    /// The lobes, the deepest first.
    pub(super) lobes: Vec<Lobe>,
    /// The necks between them.
    pub(super) necks: Vec<Neck>,
}

/// Cuts a region of `width` columns into lobes.
pub(super) fn find(inside: &[bool], width: usize, pixel_mm: [f64; 2]) -> Lobes {
    let depth_mm = depth(inside, width, pixel_mm, Rim::Outside);
    let mut order: Vec<u32> = (0_u32..).zip(inside).filter(|(_, v)| **v).map(|(p, _)| p).collect();
    order.sort_by(|&a, &b| depth_mm[b as usize].total_cmp(&depth_mm[a as usize]).then(a.cmp(&b)));
    let least_mm = LEAST_PEAK_PIXELS * pixel_mm[0].min(pixel_mm[1]);
    let mut flood = Flood {
        labels: vec![NO_LOBE; inside.len()],
        parent: Vec::new(),
        lobes: Vec::new(),
        necks: Vec::new(),
        least_mm,
    };
    for p in order {
        flood.add(p as usize, f64::from(depth_mm[p as usize]), width);
    }
    flood.finish(depth_mm)
}

struct Flood {
    labels: Vec<u32>,
    parent: Vec<u32>,
    lobes: Vec<Lobe>,
    necks: Vec<Neck>,
    least_mm: f64,
}

impl Flood {
    fn root(&mut self, mut lobe: u32) -> u32 {
        while self.parent[lobe as usize] != lobe {
            let above = self.parent[self.parent[lobe as usize] as usize];
            self.parent[lobe as usize] = above;
            lobe = above;
        }
        lobe
    }

    /// The lobes that the pixel's neighbours belong to, the deepest first.
    fn beside(&mut self, p: usize, width: usize) -> Vec<u32> {
        let column = p % width;
        let near = [
            (column > 0).then(|| p - 1),
            (column + 1 < width).then(|| p + 1),
            p.checked_sub(width),
            Some(p + width).filter(|&q| q < self.labels.len()),
        ];
        let known: Vec<u32> =
            near.into_iter().flatten().map(|q| self.labels[q]).filter(|&l| l != NO_LOBE).collect();
        let mut roots: Vec<u32> = known.into_iter().map(|l| self.root(l)).collect();
        // Lobes are numbered in the order of falling depth.
        roots.sort_unstable();
        roots.dedup();
        roots
    }

    fn add(&mut self, p: usize, depth_mm: f64, width: usize) {
        let beside = self.beside(p, width);
        let Some((&main, others)) = beside.split_first() else {
            let lobe = u32::try_from(self.lobes.len()).unwrap_or(NO_LOBE - 1);
            self.labels[p] = lobe;
            self.parent.push(lobe);
            self.lobes.push(Lobe { n_pixels: 1, radius_mm: depth_mm, at: p });
            return;
        };
        for &other in others {
            let lobe = self.lobes[other as usize];
            if lobe.radius_mm < self.least_mm || depth_mm >= NARROW * lobe.radius_mm {
                self.parent[other as usize] = main;
                self.lobes[main as usize].n_pixels += lobe.n_pixels;
            } else {
                self.necks.push(Neck { lobes: [main, other], width_mm: 2.0 * depth_mm, at: p });
            }
        }
        self.labels[p] = main;
        self.lobes[main as usize].n_pixels += 1;
    }

    fn finish(mut self, depth_mm: Vec<f32>) -> Lobes {
        let mut number = vec![NO_LOBE; self.lobes.len()];
        let mut lobes = Vec::new();
        for (lobe, number) in number.iter_mut().enumerate() {
            if self.parent[lobe] as usize == lobe {
                *number = u32::try_from(lobes.len()).unwrap_or(NO_LOBE - 1);
                lobes.push(self.lobes[lobe]);
            }
        }
        let mut labels = std::mem::take(&mut self.labels);
        for label in labels.iter_mut().filter(|l| **l != NO_LOBE) {
            *label = number[self.root(*label) as usize];
        }
        let mut necks = std::mem::take(&mut self.necks);
        for neck in &mut necks {
            neck.lobes = neck.lobes.map(|l| number[self.root(l) as usize]);
            neck.lobes.sort_unstable();
        }
        // The widest passage between two lobes counts; it was met first.
        necks.sort_by_key(|n| n.lobes);
        necks.dedup_by_key(|n| n.lobes);
        necks.retain(|n| n.lobes[0] != n.lobes[1]);
        Lobes { labels, depth_mm, lobes, necks }
    }
}

/// What is beyond the rim of the pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rim {
    /// Outside.
    Outside,
    /// Nothing that a distance counts to.
    Nothing,
}

/// Distance to the nearest pixel outside, less half a pixel, mm; 0 outside.
pub(super) fn depth(inside: &[bool], width: usize, [sx, sy]: [f64; 2], rim: Rim) -> Vec<f32> {
    // Farther than any image is wide, and its square still has its digits beside a pixel's.
    let beyond = if rim == Rim::Outside { 0.0 } else { 1e6 };
    let height = inside.len().checked_div(width).unwrap_or(0);
    let mut squared = vec![0.0_f64; inside.len()];
    // Along rows two sweeps do; along columns the lower envelope of parabolas.
    for (row, out) in inside.chunks(width.max(1)).zip(squared.chunks_mut(width.max(1))) {
        let mut since = beyond;
        for (v, d) in row.iter().zip(out.iter_mut()) {
            since = if *v { since + sx } else { 0.0 };
            *d = since;
        }
        since = beyond;
        for (v, d) in row.iter().zip(out.iter_mut()).rev() {
            since = if *v { since + sx } else { 0.0 };
            *d = d.min(since).powi(2);
        }
    }
    let half = 0.25 * (sx + sy);
    let mut depth = vec![0.0_f32; inside.len()];
    let mut envelope = Envelope::default();
    let mut column = vec![beyond * beyond; height + 2];
    for i in 0..width {
        for j in 0..height {
            column[j + 1] = squared[j * width + i];
        }
        envelope.build(&column, sy);
        for j in (0..height).filter(|&j| inside[j * width + i]) {
            #[expect(clippy::cast_possible_truncation, reason = "single precision is finer than any pixel")]
            let d = (envelope.at(&column, (j + 1) as f64 * sy, sy).sqrt() - half).max(0.1 * half) as f32;
            depth[j * width + i] = d;
        }
    }
    depth
}

/// The lower envelope of parabolas over a line of samples.
#[derive(Default)]
struct Envelope {
    feet: Vec<usize>,
    from: Vec<f64>,
    cursor: usize,
}

impl Envelope {
    fn build(&mut self, f: &[f64], step: f64) {
        self.feet.clear();
        self.from.clear();
        self.cursor = 0;
        for q in 0..f.len() {
            let x = q as f64 * step;
            let mut start = f64::NEG_INFINITY;
            while let Some(&v) = self.feet.last() {
                let w = v as f64 * step;
                start = ((f[q] + x * x) - (f[v] + w * w)) / (2.0 * (x - w));
                if start > self.from[self.from.len() - 1] {
                    break;
                }
                self.feet.pop();
                self.from.pop();
                start = f64::NEG_INFINITY;
            }
            self.feet.push(q);
            self.from.push(start);
        }
    }

    /// The envelope at a place; places must ascend.
    fn at(&mut self, f: &[f64], x: f64, step: f64) -> f64 {
        while self.cursor + 1 < self.feet.len() && self.from[self.cursor + 1] < x {
            self.cursor += 1;
        }
        let v = self.feet[self.cursor];
        (x - v as f64 * step).powi(2) + f[v]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn region(width: usize, height: usize, inside: impl Fn(f64, f64) -> bool) -> Vec<bool> {
        (0..width * height).map(|p| inside((p % width) as f64, (p / width) as f64)).collect()
    }

    fn disc(x: f64, y: f64, r: f64) -> impl Fn(f64, f64) -> bool {
        move |i, j| (i - x).hypot(j - y) < r
    }

    #[test]
    fn depth_is_the_distance_to_the_nearest_pixel_outside() {
        let inside = region(40, 30, |i, j| disc(18.0, 14.0, 9.3)(i, j) && !disc(21.0, 12.0, 2.0)(i, j));
        let found = find(&inside, 40, [0.5, 0.8]);
        for p in (0..inside.len()).filter(|&p| inside[p]) {
            let distance = |q: usize| {
                let dx = ((p % 40) as f64 - (q % 40) as f64) * 0.5;
                dx.hypot(((p / 40) as f64 - (q / 40) as f64) * 0.8)
            };
            let nearest =
                (0..inside.len()).filter(|&q| !inside[q]).map(distance).fold(f64::INFINITY, f64::min);
            assert!((f64::from(found.depth_mm[p]) - (nearest - 0.325).max(0.0325)).abs() < 1e-5, "{p}");
        }
    }

    #[test]
    fn discs_are_one_lobe_and_two_joined_by_a_neck_are_two() {
        for r in [2.0, 3.5, 8.0, 15.0] {
            let one = find(&region(64, 64, disc(30.3, 31.8, r)), 64, [0.4, 0.4]);
            assert_eq!(one.lobes.len(), 1, "{r}");
            // To a pixel: the largest disc of whole pixels is smaller than the true one.
            assert!((one.lobes[0].radius_mm - 0.4 * r).abs() < 0.4, "{r}: {:?}", one.lobes[0]);
            assert!(one.necks.is_empty());
        }
        let bar = |i: f64, j: f64| (20.0..44.0).contains(&i) && (j - 32.0).abs() < 2.0;
        let two = |i: f64, j: f64| disc(18.0, 32.0, 9.0)(i, j) || disc(46.0, 32.0, 12.0)(i, j) || bar(i, j);
        let found = find(&region(64, 64, two), 64, [0.4, 0.4]);
        assert_eq!((found.lobes.len(), found.necks.len()), (2, 1));
        assert!((found.necks[0].width_mm - 1.6).abs() < 0.5, "{:?}", found.necks);
        let at = found.necks[0].at % 64;
        assert!((26..36).contains(&at), "{at}");
    }

    #[test]
    fn long_sections_of_slanted_vessels_are_one_lobe() {
        let long = region(64, 64, |i, j| ((i - 32.0) / 26.0).hypot((j - 32.0) / 6.0) < 1.0);
        assert_eq!(find(&long, 64, [0.4, 0.4]).lobes.len(), 1);
    }
}
