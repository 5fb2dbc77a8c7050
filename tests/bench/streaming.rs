//! Streaming over a real pseudo-terminal to a printer that takes no time: lines a second, CPU time and memory of the host alone.
//!
//! The printer is this program once more, as a process of its own. `cargo bench --bench streaming` fails where a limit is missed: at least
//! 50,000 lines/s (on a machine that is not busy), at most 1 CPU second for 100,000 lines, at most 30 MB (the peak of all runs).

#![expect(clippy::print_stdout, reason = "the table is what the bench is for")]

use lumenfab::printer::control::Controls;
use lumenfab::printer::driver::{self, Order, PrintEvent};
use lumenfab::printer::job::Job;
use lumenfab::printer::journal::writer::Journal;
use lumenfab::printer::serial;
use lumenfab::printer::session::Start;
use lumenfab::profile::{self, Profile};
use lumenfab::progress::CancelToken;
use std::io::{BufRead, BufReader, BufWriter, Read, Write};
use std::path::Path;
use std::process::{Command, ExitCode, Stdio};

const PRINTER: &str = "--printer-process";
const N_LINES: usize = 1_000_000;
/// CPU time counts in hundredths of a second on Linux.
const TICKS_PER_S: f64 = 100.0;
/// What is asked of the host.
const LEAST_LINES_PER_S: f64 = 50_000.0;
const MOST_CPU_S: f64 = 1.0;
const MOST_MB: f64 = 30.0;

fn main() -> ExitCode {
    if std::env::args().any(|arg| arg == PRINTER) {
        be_a_printer();
    }
    let mut is_held = true;
    let profile = profile::builtin("marlin").expect("built in");
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("job.gcode");
    write_job(&path).expect("a job is written");
    println!("{:<28} {:>10} {:>16} {:>8}", "window", "lines/s", "CPU s/100,000", "MB");
    for (name, rx_bytes) in [("profile's, 128 bytes", 128), ("flow-controlled, 4096 bytes", 4096)] {
        let mut profile = profile.clone();
        profile.firmware.rx_buffer_bytes = rx_bytes;
        let (lines_per_s, cpu_s) = stream(&path, &profile);
        let mb = peak_mb();
        println!("{name:<28} {lines_per_s:>10.0} {cpu_s:>16.2} {mb:>8.1}");
        is_held &= lines_per_s >= LEAST_LINES_PER_S && cpu_s <= MOST_CPU_S && mb <= MOST_MB;
    }
    if !is_held {
        println!("beyond {LEAST_LINES_PER_S} lines/s, {MOST_CPU_S} CPU s or {MOST_MB} MB");
    }
    if is_held { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// A vessel's lines: 43 bytes on the wire.
fn write_job(path: &Path) -> std::io::Result<()> {
    let mut file = BufWriter::new(std::fs::File::create(path)?);
    writeln!(file, "G28")?;
    for i in 0..N_LINES {
        let (x, y) = (100.0 + (i % 977) as f64 * 0.01, 90.0 + (i % 1013) as f64 * 0.01);
        writeln!(file, "G1 X{x:.3} Y{y:.3} E{:.5}", 0.01 + (i % 7) as f64 * 1e-3)?;
    }
    file.flush()
}

fn stream(job: &Path, profile: &Profile) -> (f64, f64) {
    let program = std::env::current_exe().expect("this program");
    let mut printer =
        Command::new(program).arg(PRINTER).stdout(Stdio::piped()).spawn().expect("a printer starts");
    let mut port = String::new();
    let stdout = printer.stdout.as_mut().expect("piped");
    BufReader::new(stdout).read_line(&mut port).expect("the printer names its port");
    let before_s = cpu_s();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let elapsed_s = runtime.expect("a runtime").block_on(print(job, Path::new(port.trim()), profile));
    let used_s = cpu_s() - before_s;
    printer.kill().ok();
    printer.wait().ok();
    let n = N_LINES as f64;
    (n / elapsed_s, used_s / n * 1e5)
}

async fn print(path: &Path, port: &Path, profile: &Profile) -> f64 {
    let job = Job::from_file(path, &profile.firmware).expect("the job is sound");
    let link = serial::open(port, &profile.firmware, None).await.expect("the port opens");
    let journal = Journal::create(&path.with_extension("journal"), &[]).expect("a journal");
    let (sender, mut events) = tokio::sync::mpsc::channel::<PrintEvent>(256);
    let listener = tokio::spawn(async move { while events.recv().await.is_some() {} });
    let controls = Controls::default();
    let order = Order { job, start: Start::Fresh, journal: Some(journal), controls };
    let cancel = CancelToken::default();
    let printed = driver::run(order, link, profile, &sender, &cancel).await.expect("it prints");
    drop(sender);
    listener.await.expect("the listener ends");
    printed.elapsed.as_secs_f64()
}

/// Takes lines, checks their numbers, says `ok`.
fn be_a_printer() -> ! {
    let (mut master, slave) = serialport::TTYPort::pair().expect("a pseudo-terminal");
    let name = serialport::SerialPort::name(&slave).expect("it has a name");
    drop(slave);
    println!("{name}");
    std::io::stdout().flush().ok();
    let (mut pending, mut buffer, mut said) = (Vec::new(), vec![0; 1 << 16], Vec::new());
    let mut last = 7_u64;
    loop {
        match master.read(&mut buffer) {
            Ok(n) => pending.extend_from_slice(&buffer[..n]),
            // Nobody there yet, or nothing to read within the port's time-out.
            Err(_) => std::thread::yield_now(),
        }
        let Some(end) = pending.iter().rposition(|&b| b == b'\n') else { continue };
        for line in pending[..end].split(|&b| b == b'\n').filter(|line| !line.is_empty()) {
            answer(line, &mut last, &mut said);
        }
        pending.drain(..=end);
        if master.write_all(&said).is_ok() {
            said.clear();
        }
    }
}

fn answer(line: &[u8], last: &mut u64, said: &mut Vec<u8>) {
    if line.first() != Some(&b'N') {
        said.extend_from_slice(if line == b"M105" { b"ok T:20 /0 B:20 /0\n" } else { b"ok\n" });
        return;
    }
    let digits = line[1..].iter().take_while(|b| b.is_ascii_digit());
    let number = digits.fold(0, |n, b| n * 10 + u64::from(b - b'0'));
    if number == *last + 1 || line.windows(4).any(|word| word == b"M110") {
        *last = number;
        said.extend_from_slice(b"ok\n");
    } else {
        let text = format!(
            "Error:Line Number is not Last Line Number+1, Last Line: {last}\nResend: {}\nok\n",
            *last + 1
        );
        said.extend_from_slice(text.as_bytes());
    }
}

/// CPU time of this process, s.
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat.rsplit(')').next().unwrap_or_default().split_ascii_whitespace();
    let ticks: f64 = fields.skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum();
    ticks / TICKS_PER_S
}

/// Most memory that this process has held, MB.
fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM:")).unwrap_or_default();
    line.split_ascii_whitespace().nth(1).and_then(|kb| kb.parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
}
