//! Changes seeds at random and gives them to the targets: without coverage and sanitizer, for any stable compiler.
//!
//!     cargo run --release --no-default-features --bin shake -- corpus SECONDS [SEED] [TARGET]...
//!
//! What panics is written to `artifacts/TARGET/`, and the exit code is 1.

use lumenfab_fuzz::TARGETS;
use std::fs;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Numbers that lie at the edges of what a field can hold.
const EDGES: [u64; 10] = [0, 1, 0x7f, 0x80, 0xff, 0x7fff, 0xffff, 0x7fff_ffff, 0xffff_ffff, u64::MAX];

/// A linear congruential generator: the same seed, the same files.
struct Chance(u64);

impl Chance {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % n.max(1)
    }

    fn changed(&mut self, seeds: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = seeds[self.below(seeds.len())].clone();
        for _ in 0..=self.below(6) {
            self.change(&mut bytes, seeds);
        }
        bytes
    }

    fn change(&mut self, bytes: &mut Vec<u8>, seeds: &[Vec<u8>]) {
        let at = self.below(bytes.len());
        match self.below(8) {
            0 => bytes.truncate(at),
            1 => bytes.insert(at, self.below(256) as u8),
            2 if !bytes.is_empty() => drop(bytes.remove(at)),
            3 => {
                let other = &seeds[self.below(seeds.len())];
                let from = self.below(other.len());
                let n = self.below(64).min(other.len() - from);
                bytes.splice(at..at, other[from..from + n].iter().copied());
            }
            4 => {
                let n = [1, 2, 4, 8][self.below(4)];
                let number = EDGES[self.below(EDGES.len())].to_le_bytes();
                bytes.iter_mut().skip(at).take(n).zip(number).for_each(|(b, v)| *b = v);
            }
            5 => {
                // Another digit keeps text readable.
                let digit = b'0' + self.below(10) as u8;
                if let Some(b) = bytes[at..].iter_mut().find(|b| b.is_ascii_digit()) {
                    *b = digit;
                }
            }
            _ => {
                let bit = 1 << self.below(8);
                if let Some(b) = bytes.get_mut(at) {
                    *b ^= bit;
                }
            }
        }
    }
}

fn seeds_of(folder: &Path) -> Vec<Vec<u8>> {
    let mut files: Vec<PathBuf> =
        fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
    files.sort();
    files.iter().filter_map(|f| fs::read(f).ok()).filter(|b| !b.is_empty()).collect()
}

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, default| args.get(i).and_then(|a| a.parse().ok()).unwrap_or(default);
    let corpus = PathBuf::from(args.first().map_or("corpus", String::as_str));
    let (seconds, seed) = (number(1, 60), number(2, 1));
    let wanted = args.get(3..).unwrap_or_default();
    let mut n_found = 0;
    for (name, target) in TARGETS {
        let seeds = seeds_of(&corpus.join(name));
        if seeds.is_empty() || !(wanted.is_empty() || wanted.iter().any(|w| w == name)) {
            continue;
        }
        let (mut chance, start) = (Chance(seed), Instant::now());
        let (mut n, mut slowest) = (0_u64, Duration::ZERO);
        while start.elapsed() < Duration::from_secs(seconds) {
            let bytes = chance.changed(&seeds);
            let begun = Instant::now();
            if catch_unwind(|| target(&bytes)).is_err() {
                n_found += 1;
                let folder = Path::new("artifacts").join(name);
                fs::create_dir_all(&folder).expect("a folder can be made");
                fs::write(folder.join(format!("panic-{seed}-{n}")), &bytes).expect("a file can be written");
            }
            (n, slowest) = (n + 1, slowest.max(begun.elapsed()));
        }
        println!("{name}: {n} files, slowest {:.3} s", slowest.as_secs_f64());
    }
    println!("{n_found} panics");
    std::process::exit(i32::from(n_found > 0));
}
