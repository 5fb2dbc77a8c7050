//! What the operator decides, in `config.toml`: pure parsing, all faults at once.
//!
//! Every key has a default; a server without the file has one simulated printer. `deploy/config.toml` explains each key, and a test
//! holds it to be what is read here.

mod read;

pub use read::{Fault, Faults};

use crate::queue::{Material, Name};
use read::Keys;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;
use toml::Value;

/// Everything that is decided.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// The printers of this server, at least one.
    pub printers: Vec<PrinterConfig>,
    /// What is listened to beside the socket.
    pub http: Http,
    /// How G-code is made.
    pub prepare: Prepare,
    /// What becomes of prints when the server is asked to stop.
    pub on_stop: OnStop,
    /// Who is told what happens.
    pub webhook: Option<Webhook>,
    /// A folder whose files become jobs.
    pub watch: Option<Watch>,
    /// What is kept on the disk.
    pub disk: Disk,
    /// Folders that CTs lie below.
    pub ct_folders: Vec<PathBuf>,
}

/// What is listened to beside the socket.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Http {
    /// Loopback addresses; served only where keys exist.
    pub tcp: Vec<SocketAddr>,
    /// Largest upload, bytes.
    pub max_upload_bytes: u64,
}

/// How G-code is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Prepare {
    /// Jobs that are prepared at once; 0: none here.
    pub workers: u32,
    /// Threads of each.
    pub threads: u32,
    /// Niceness, 0 to 19.
    pub nice: u8,
    /// Longest preparation of a job.
    pub longest: Duration,
}

/// What becomes of prints when the server is asked to stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum OnStop {
    /// They are finished first.
    Finish,
    /// They are paused, the nozzle away from the part, warm: the next server, or `lumenfab resume`, goes on with them.
    Park,
    /// They are given up, the heaters switched off.
    Cancel,
}

/// Who is told what happens.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Webhook {
    /// Host of the address.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// The rest of it.
    pub path: String,
}

/// A folder whose files become jobs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Watch {
    /// The folder.
    pub folder: PathBuf,
    /// Whether they go into the queue at once, or stay drafts.
    pub submit: bool,
    /// For so long a file has not changed before it is taken.
    pub still: Duration,
}

/// What is kept on the disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Disk {
    /// While less is free, nothing is uploaded or prepared, bytes.
    pub reserve_bytes: u64,
    /// What belongs to a job is removed so long after its end.
    pub keep: Duration,
}

/// A printer.
#[derive(Debug, Clone, PartialEq)]
pub struct PrinterConfig {
    /// Its name in the queue.
    pub name: Name,
    /// Name or file of its profile.
    pub profile: String,
    /// Where it is.
    pub port: Port,
    /// Rate of the wire instead of the profile's, 1/s.
    pub baud: Option<u32>,
    /// What it has loaded, instead of the profile's.
    pub material: Option<Material>,
    /// What it may do without anybody near.
    pub limits: PrintLimits,
    /// Whether it pauses behind the first layer, for a look.
    pub first_layer_hold: bool,
    /// For so long without a server its bed is believed to be as it was.
    pub bed_trusted: Duration,
    /// From the end of a copy until its bed can be expected to be clear.
    pub clearing: Duration,
    /// What clears its bed, and says that it is clear.
    pub bed_clear: Option<Hook>,
}

/// Where a printer is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Port {
    /// The simulated one, at this speed.
    Simulated {
        /// `max`, `realtime` or a factor.
        speed: String,
    },
    /// A path, or `usb:VENDOR:PRODUCT[:SERIAL]`.
    Path(String),
}

/// What a printer may do without anybody near.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrintLimits {
    /// Longest print.
    pub longest: Duration,
    /// Hottest nozzle, °C.
    pub hotend_c: f64,
    /// Hottest bed, °C.
    pub bed_c: f64,
}

impl PrintLimits {
    /// Why heaters may not be set so hot, °C.
    pub(super) fn refuse_heat(&self, hotend_c: f64, bed_c: f64) -> Option<String> {
        let is_beyond = hotend_c > self.hotend_c || bed_c > self.bed_c;
        is_beyond.then(|| {
            format!(
                "it sets the nozzle to {hotend_c:.0} °C and the bed to {bed_c:.0} °C; {:.0} and {:.0} °C are allowed",
                self.hotend_c, self.bed_c
            )
        })
    }
}

/// A program that is run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hook {
    /// Its path, then its arguments.
    pub program: Vec<String>,
    /// It is ended after so long.
    pub longest: Duration,
}

impl Default for Config {
    /// One simulated printer.
    fn default() -> Self {
        Self::parse("", "config.toml").expect("every key has a default")
    }
}

/// The simulated printer, where a port is named.
const SIMULATED: &str = "sim";

impl Config {
    /// Of the file's text; `file` is what faults call it.
    ///
    /// # Errors
    /// [`Faults`]: all that is wrong, each with its line and key.
    pub fn parse(text: &str, file: &str) -> Result<Self, Faults> {
        let mut keys = Keys::parse(text, file)?;
        let printers = match keys.n_tables("printer") {
            // Of a table that is not there every key has its default.
            0 => vec![Section { keys: &mut keys, path: "printer.0.".to_owned() }.printer()],
            n => (0..n)
                .map(|idx| Section { keys: &mut keys, path: format!("printer.{idx}.") }.printer())
                .collect(),
        };
        let mut root = Section { keys: &mut keys, path: String::new() };
        let config = Self {
            http: root.within("http").http(),
            prepare: root.within("prepare").prepare(),
            on_stop: root.choice("on_stop", OnStop::Finish, &OnStop::WORDS),
            webhook: root.option("webhook_url", WEBHOOK, |v| url(v.as_str()?)),
            watch: root.within("watch").watch(),
            disk: root.within("disk").disk(),
            ct_folders: root.within("cases").ct_folders(),
            printers,
        };
        keys.end(file)?;
        Ok(config)
    }
}

impl OnStop {
    const WORDS: [(&'static str, Self); 3] =
        [("finish", Self::Finish), ("park", Self::Park), ("cancel", Self::Cancel)];
}

const WEBHOOK: &str = "an address such as \"http://127.0.0.1:9000/lumenfab\"; https is not spoken here: let a program of this machine pass it on";

/// A table of the file.
struct Section<'a> {
    keys: &'a mut Keys,
    /// With a dot behind it, or empty.
    path: String,
}

impl Section<'_> {
    fn within(&mut self, table: &str) -> Section<'_> {
        Section { keys: self.keys, path: format!("{}{table}.", self.path) }
    }

    fn http(&mut self) -> Http {
        let address = "a list of addresses such as \"127.0.0.1:8125\"";
        let tcp = |v: &Value| v.as_array()?.iter().map(|v| v.as_str()?.parse().ok()).collect();
        Http {
            tcp: self.option("tcp", address, tcp).unwrap_or_default(),
            max_upload_bytes: self.whole("max_upload_bytes", 2 << 30, [1 << 10, 64 << 30]),
        }
    }

    fn prepare(&mut self) -> Prepare {
        Prepare {
            workers: self.whole("workers", 1, [0, 64]),
            threads: self.whole("threads", 1, [1, 256]),
            nice: self.whole("nice", 10, [0, 19]),
            longest: self.seconds("longest_s", 4 * 3600, [1, 7 * 86_400]),
        }
    }

    fn watch(&mut self) -> Option<Watch> {
        let absolute = |v: &Value| Some(PathBuf::from(v.as_str()?)).filter(|path| path.is_absolute());
        let folder = self.option("folder", "an absolute path", absolute);
        let submit = self.flag("submit", false);
        let still = self.seconds("still_s", 30, [0, 86_400]);
        folder.map(|folder| Watch { folder, submit, still })
    }

    fn ct_folders(&mut self) -> Vec<PathBuf> {
        let absolute = |v: &Value| Some(PathBuf::from(v.as_str()?)).filter(|path| path.is_absolute());
        let all = |v: &Value| v.as_array()?.iter().map(absolute).collect();
        self.option("ct_folders", "a list of absolute paths", all).unwrap_or_default()
    }

    fn disk(&mut self) -> Disk {
        let reserve_mb: u64 = self.whole("reserve_mb", 512, [0, 1 << 20]);
        let keep_days: u64 = self.whole("keep_days", 30, [1, 36_500]);
        Disk { reserve_bytes: reserve_mb << 20, keep: Duration::from_secs(86_400 * keep_days) }
    }

    fn printer(&mut self) -> PrinterConfig {
        let line = self.keys.line_of(&format!("{}name", self.path));
        let name = self.option("name", "a name of 1 to 64 characters", |v| Name::try_new(v.as_str()?).ok());
        let name = name.unwrap_or_else(|| Name::try_new("printer").expect("a name that is written here"));
        if !self.keys.is_first("printer.name", name.as_str()) {
            self.keys.fault(
                line,
                "printer.name",
                &format!("{name} once more"),
                "another name for each printer",
            );
        }
        PrinterConfig {
            name,
            profile: self.text("profile", "marlin", "a name of `lumenfab profiles list` or a file"),
            port: self.port(),
            baud: self.option("baud", "a whole number from 1200 to 4000000", |v| {
                u32::try_from(v.as_integer()?).ok().filter(|rate| (1200..=4_000_000).contains(rate))
            }),
            material: self
                .option("material", "a material such as \"PLA\"", |v| Material::try_new(v.as_str()?).ok()),
            limits: PrintLimits {
                longest: self.seconds("longest_print_s", 72 * 3600, [60, 60 * 86_400]),
                hotend_c: self.number("max_hotend_c", 280.0, [0.0, 500.0]),
                bed_c: self.number("max_bed_c", 120.0, [0.0, 200.0]),
            },
            first_layer_hold: self.flag("first_layer_hold", false),
            bed_trusted: self.seconds("bed_trusted_s", 120, [0, 366 * 86_400]),
            clearing: self.seconds("clearing_s", 900, [0, 86_400]),
            bed_clear: self.hook(),
        }
    }

    fn port(&mut self) -> Port {
        let port = self.text("port", SIMULATED, "\"sim\", a path, or usb:VENDOR:PRODUCT[:SERIAL]");
        let speeds = "\"max\", \"realtime\" or a factor such as \"60\"";
        let speed = self.option("sim_speed", speeds, |v| speed(v.as_str()?));
        if port == SIMULATED {
            Port::Simulated { speed: speed.unwrap_or_else(|| "max".to_owned()) }
        } else {
            Port::Path(port)
        }
    }

    fn hook(&mut self) -> Option<Hook> {
        let words = |v: &Value| -> Option<Vec<String>> {
            let words: Option<Vec<_>> = v.as_array()?.iter().map(|w| w.as_str().map(str::to_owned)).collect();
            words.filter(|words| words.first().is_some_and(|path| path.starts_with('/')))
        };
        let program =
            self.option("bed_clear_program", "a list of texts, the first one an absolute path", words);
        let longest = self.seconds("bed_clear_longest_s", 600, [1, 86_400]);
        program.map(|program| Hook { program, longest })
    }

    fn option<T>(&mut self, key: &str, expected: &str, read: impl FnOnce(&Value) -> Option<T>) -> Option<T> {
        self.keys.take(&format!("{}{key}", self.path), expected, read)
    }

    fn text(&mut self, key: &str, default: &str, expected: &str) -> String {
        let read = |v: &Value| v.as_str().filter(|text| !text.is_empty()).map(str::to_owned);
        self.option(key, expected, read).unwrap_or_else(|| default.to_owned())
    }

    fn seconds(&mut self, key: &str, default: u64, range: [i64; 2]) -> Duration {
        Duration::from_secs(self.whole(key, default, range))
    }

    fn whole<T: TryFrom<i64>>(&mut self, key: &str, default: T, [least, most]: [i64; 2]) -> T {
        let expected = format!("a whole number from {least} to {most}");
        let read = |v: &Value| v.as_integer().filter(|n| (least..=most).contains(n))?.try_into().ok();
        self.option(key, &expected, read).unwrap_or(default)
    }

    fn number(&mut self, key: &str, default: f64, [least, most]: [f64; 2]) -> f64 {
        let expected = format!("a number from {least} to {most}");
        // Whole numbers beyond 2^53 lie outside every range here.
        let number = |v: &Value| v.as_float().or_else(|| v.as_integer().map(|whole| whole as f64));
        let read = |v: &Value| number(v).filter(|n| (least..=most).contains(n));
        self.option(key, &expected, read).unwrap_or(default)
    }

    fn flag(&mut self, key: &str, default: bool) -> bool {
        self.option(key, "true or false", Value::as_bool).unwrap_or(default)
    }

    fn choice<T: Copy>(&mut self, key: &str, default: T, choices: &[(&str, T)]) -> T {
        let words: Vec<_> = choices.iter().map(|(word, _)| *word).collect();
        let expected = format!("one of {}", words.join(", "));
        let read =
            |v: &Value| choices.iter().find(|(word, _)| v.as_str() == Some(word)).map(|(_, choice)| *choice);
        self.option(key, &expected, read).unwrap_or(default)
    }
}

fn speed(text: &str) -> Option<String> {
    let is_factor = || text.parse::<f64>().is_ok_and(|factor| factor.is_finite() && factor > 0.0);
    (matches!(text, "max" | "realtime") || is_factor()).then(|| text.to_owned())
}

/// `http://HOST[:PORT][/PATH]`.
fn url(text: &str) -> Option<Webhook> {
    let rest = text.strip_prefix("http://")?;
    let (place, path) = rest.split_at(rest.find('/').unwrap_or(rest.len()));
    // An address of version 6 stands in brackets, and has colons of its own.
    let (host, port) = match place.rsplit_once(':') {
        Some((host, port)) if !port.ends_with(']') => (host, port.parse().ok()?),
        _ => (place, 80),
    };
    let is_clean = |text: &str| text.bytes().all(|b| b.is_ascii_graphic());
    if host.is_empty() || host.contains('@') || !is_clean(host) || !is_clean(path) {
        return None;
    }
    let path = if path.is_empty() { "/" } else { path };
    Some(Webhook { host: host.to_owned(), port, path: path.to_owned() })
}

#[cfg(test)]
mod tests;
