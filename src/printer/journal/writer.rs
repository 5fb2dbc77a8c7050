//! The thread that owns the journal's file (IO).
//!
//! The streaming task hands records over and never waits: where the disk is slow, a record of progress is left out and a later
//! one says more. Each session begins with a file written anew, whole or not at all, with its lines for progress laid out; records of
//! progress then go over the oldest of these, so that a disk that fills up does not matter. Where the file cannot be written
//! anew, they are appended: a write that fails may leave half a line behind; the next one begins with a line feed, so that only
//! that line is lost, and writing goes on once there is room.

use super::{Error, Log, N_SLOTS, Progress, Record, SLOT_BYTES, encode, encode_slot, header};
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Records that may wait for the disk.
const WAITING: usize = 64;

/// An open journal.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    sender: Option<SyncSender<Order>>,
    thread: Option<JoinHandle<()>>,
    failure: Arc<Mutex<Option<String>>>,
}

#[derive(Debug)]
enum Order {
    Append(Record, Instant),
    /// Answered when all before it is on the disk, or not: whether it is.
    Flush(SyncSender<bool>),
}

impl Journal {
    /// Begins a new journal at `path` with these records; one that is there is replaced.
    ///
    /// # Errors
    /// [`Error::Foreign`] where something else has this name; [`Error::Io`].
    pub fn create(path: &Path, records: &[Record]) -> Result<Self, Error> {
        refuse_foreign(path)?;
        let mut bytes = header();
        records.iter().for_each(|record| bytes.extend(encode(record)));
        replace(path, &bytes).map_err(|source| Error::Io {
            path: path.to_owned(),
            action: "written",
            source: without_path(&source),
        })?;
        Self::append_to(path)
    }

    /// Goes on with the journal at `path`.
    ///
    /// # Errors
    /// [`Error::Io`], also where the thread cannot be started.
    pub fn append_to(path: &Path) -> Result<Self, Error> {
        let failed = |source| Error::Io { path: path.to_owned(), action: "written", source };
        let file = open(path).map_err(failed)?;
        let failure = Arc::new(Mutex::new(None));
        let (sender, orders) = sync_channel(WAITING);
        // A file that ends within a line was torn.
        let is_torn = !ends_with_a_line(&file).map_err(failed)?;
        let disk = Disk {
            file,
            is_torn,
            failure: Arc::clone(&failure),
            delay: Duration::ZERO,
            written: None,
            next_slot: None,
            path: Some(path.to_owned()),
        };
        let work = move || disk.serve(&orders);
        let thread = std::thread::Builder::new().name("journal".into()).spawn(work).map_err(failed)?;
        Ok(Self { path: path.to_owned(), sender: Some(sender), thread: Some(thread), failure })
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Hands a record over; false where too many wait already. Never blocks.
    pub fn append(&self, record: &Record) -> bool {
        let order = Order::Append(record.clone(), now());
        self.sender.as_ref().is_some_and(|sender| sender.try_send(order).is_ok())
    }

    /// Waits until all that was handed over is on the disk.
    pub fn flush(&self) {
        let (answer, done) = sync_channel(1);
        if let Some(sender) = &self.sender
            && sender.send(Order::Flush(answer)).is_ok()
        {
            // The thread ends only with this sender, and answers before.
            done.recv().ok();
        }
    }

    /// Asks to be told when all that was handed over is on the disk; nothing where too much waits already. Never blocks.
    #[must_use]
    pub fn ask_flush(&self) -> Option<Flush> {
        let (answer, done) = sync_channel(1);
        let sender = self.sender.as_ref()?;
        sender.try_send(Order::Flush(answer)).is_ok().then_some(Flush(done))
    }

    /// Why the last record could not be written; nothing where it was.
    #[must_use]
    pub fn failure(&self) -> Option<String> {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        self.sender = None;
        if let Some(thread) = self.thread.take() {
            // What it could not write it has told.
            thread.join().ok();
        }
    }
}

/// A flush under way.
#[derive(Debug)]
pub struct Flush(Receiver<bool>);

impl Flush {
    /// Whether all is on the disk; false where it could not be written ([`Journal::failure`] tells why), nothing while it is under way.
    #[must_use]
    pub fn outcome(&self) -> Option<bool> {
        match self.0.try_recv() {
            Ok(is_written) => Some(is_written),
            Err(TryRecvError::Empty) => None,
            // The thread ends only with its sender, and answers before.
            Err(TryRecvError::Disconnected) => Some(false),
        }
    }
}

#[expect(clippy::disallowed_methods, reason = "how long the disk takes")]
fn now() -> Instant {
    Instant::now()
}

fn open(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).write(true).mode(0o600).open(path)
}

/// Whole or not at all; readable by its owner alone, as tempfile makes it by itself.
fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let dir = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut file = tempfile::Builder::new().prefix(".lumenfab-").tempfile_in(dir)?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    file.persist(path)?;
    File::open(dir)?.sync_all()
}

fn ends_with_a_line(file: &File) -> io::Result<bool> {
    let Some(at) = file.metadata()?.len().checked_sub(1) else { return Ok(true) };
    let mut last = [0];
    file.read_exact_at(&mut last, at)?;
    Ok(last == *b"\n")
}

/// The file, on its own thread.
struct Disk<F> {
    file: F,
    /// It ends within a line.
    is_torn: bool,
    failure: Arc<Mutex<Option<String>>>,
    /// The longest that a record of progress has taken.
    delay: Duration,
    /// When the last record was written: one that waited for that has not waited for the disk to take it.
    written: Option<Instant>,
    /// Where the lines for progress begin, and which of them is the next; none: records are appended.
    next_slot: Option<(u64, u64)>,
    /// Where it is written anew; never in tests.
    path: Option<PathBuf>,
}

/// A file as this thread needs it; a full disk in tests.
trait Flushed: Write {
    /// Over what stands there.
    fn write_over(&mut self, bytes: &[u8], at: u64) -> io::Result<()>;
    /// To its end; all is then on the disk.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;
    fn to_disk(&mut self) -> io::Result<()>;
}

impl Flushed for File {
    fn write_over(&mut self, bytes: &[u8], at: u64) -> io::Result<()> {
        self.write_all_at(bytes, at)
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.seek(SeekFrom::End(0))?;
        self.write_all(bytes)
    }

    fn to_disk(&mut self) -> io::Result<()> {
        self.sync_data()
    }
}

impl Disk<File> {
    fn serve(mut self, orders: &Receiver<Order>) {
        while let Ok(order) = orders.recv() {
            let mut late = None;
            let mut order = Some(order);
            while let Some(next) = order.take().or_else(|| orders.try_recv().ok()) {
                match next {
                    // What waits behind it says more.
                    Order::Append(Record::Progress(progress), since) => late = Some((progress, since)),
                    Order::Append(record, _) => {
                        self.progress(late.take());
                        self.other(&record);
                    }
                    Order::Flush(flush) => {
                        self.progress(late.take());
                        // Whoever asked may have gone.
                        flush.send(!self.fails()).ok();
                    }
                }
            }
            self.progress(late);
        }
    }

    /// A session begins with a file of its own.
    fn other(&mut self, record: &Record) {
        let written = match record {
            Record::Session(_) => self.anew(record).or_else(|_| self.append(&encode(record))),
            _ => self.append(&encode(record)),
        };
        self.written = Some(now());
        self.tell(written);
    }

    /// What is known so far, the session, and room for its progress.
    fn anew(&mut self, session: &Record) -> io::Result<()> {
        self.next_slot = None;
        let path = self.path.clone().ok_or(io::ErrorKind::NotFound)?;
        let mut bytes = header();
        let log = Log::head(&read(&path).map_err(io::Error::other)?);
        log.iter().for_each(|record| bytes.extend(encode(record)));
        bytes.extend(encode(session));
        let slots_at = bytes.len() as u64;
        let mut blank = vec![b' '; SLOT_BYTES - 1];
        blank.push(b'\n');
        (0..N_SLOTS).for_each(|_| bytes.extend(&blank));
        replace(&path, &bytes)?;
        self.file = open(&path)?;
        self.is_torn = false;
        self.next_slot = Some((slots_at, 0));
        Ok(())
    }
}

impl<F: Flushed> Disk<F> {
    fn progress(&mut self, handed: Option<(Progress, Instant)>) {
        let Some((mut progress, since)) = handed else { return };
        progress.delay_s = (self.delay.as_secs_f64() * 1e3).ceil() / 1e3;
        if self.next_slot.is_none() {
            // What takes a promise back needs no room on the disk, if it is to.
            progress.z_allowed_to = None;
        }
        let written = self.try_progress(&Record::Progress(progress));
        let end = now();
        if written.is_ok() {
            let since = self.written.map_or(since, |written| written.max(since));
            self.delay = self.delay.max(end.duration_since(since));
        }
        self.written = Some(end);
        self.tell(written);
    }

    fn try_progress(&mut self, record: &Record) -> io::Result<()> {
        match (self.next_slot, encode_slot(record)) {
            (Some((slots_at, n)), Some(line)) => {
                self.file.write_over(&line, slots_at + n * SLOT_BYTES as u64)?;
                self.next_slot = Some((slots_at, (n + 1) % N_SLOTS));
                self.file.to_disk()
            }
            _ => self.append(&encode(record)),
        }
    }

    fn fails(&self) -> bool {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    fn tell(&self, written: io::Result<()>) {
        let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        *failure = written.err().map(|error| error.to_string());
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        if self.is_torn {
            self.file.append(b"\n")?;
        }
        // Until all of it is there.
        self.is_torn = true;
        self.file.append(bytes)?;
        self.is_torn = false;
        self.file.to_disk()
    }
}

/// A journal may take the place of a journal, or of nothing.
fn refuse_foreign(path: &Path) -> Result<(), Error> {
    if !path.exists() {
        return Ok(());
    }
    let is_file = path.is_file();
    let known = if is_file {
        super::check_header(&first_line(path)?, path)
    } else {
        Err(Error::Foreign(path.to_owned()))
    };
    match known {
        Err(error @ Error::Foreign(_)) => Err(error),
        _ => Ok(()),
    }
}

/// An error without the name of the file that would have been renamed: nobody knows that one.
fn without_path(error: &io::Error) -> io::Error {
    let kind = error.kind();
    io::Error::new(kind, kind.to_string())
}

fn first_line(path: &Path) -> Result<Vec<u8>, Error> {
    let failed = |source| Error::Io { path: path.to_owned(), action: "read", source };
    let mut bytes = Vec::new();
    File::open(path).map_err(failed)?.take(64).read_to_end(&mut bytes).map_err(failed)?;
    Ok(bytes.split(|&b| b == b'\n').next().unwrap_or_default().to_vec())
}

/// The bytes of a journal.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, Error> {
    let failed = |source| Error::Io { path: path.to_owned(), action: "read", source };
    match std::fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Err(Error::Missing(path.to_owned())),
        Err(error) => Err(failed(error)),
        Ok(data) if !data.is_file() || data.len() > super::MAX_BYTES => Err(Error::Foreign(path.to_owned())),
        Ok(_) => std::fs::read(path).map_err(failed),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    /// A disk with room for so many bytes at each write.
    #[derive(Debug, Default)]
    struct FullDisk {
        bytes: Vec<u8>,
        rooms: VecDeque<usize>,
    }

    impl Write for FullDisk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let room = self.rooms.front_mut();
            let n = room.as_ref().map_or(bytes.len(), |room| bytes.len().min(**room));
            if n == 0 {
                self.rooms.pop_front();
                return Err(io::Error::from(io::ErrorKind::StorageFull));
            }
            if let Some(room) = room {
                *room -= n;
            }
            self.bytes.extend_from_slice(&bytes[..n]);
            Ok(n)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Flushed for FullDisk {
        fn write_over(&mut self, bytes: &[u8], at: u64) -> io::Result<()> {
            let at = usize::try_from(at).unwrap();
            self.bytes[at..at + bytes.len()].copy_from_slice(bytes);
            Ok(())
        }

        fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
            self.write_all(bytes)
        }

        fn to_disk(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn at(n_acked: u64) -> Progress {
        Progress { t_s: n_acked as f64, n_acked, ..Progress::default() }
    }

    fn progress(n_acked: u64) -> Vec<u8> {
        encode(&Record::Progress(at(n_acked)))
    }

    fn disk<F>(file: F) -> Disk<F> {
        Disk {
            written: None,
            file,
            is_torn: false,
            failure: Arc::new(Mutex::new(None)),
            delay: Duration::ZERO,
            next_slot: None,
            path: None,
        }
    }

    #[test]
    fn a_full_disk_tears_one_record_and_is_told_and_the_next_ones_are_whole() {
        for room in 0..progress(1).len() {
            let file = FullDisk { bytes: super::super::tests::begun(), rooms: [room].into() };
            let mut disk = disk(file);
            disk.progress(Some((at(1), now())));
            assert!(disk.failure.lock().unwrap().take().is_some(), "told");
            disk.file.rooms.clear();
            disk.progress(Some((at(2), now())));
            let log = Log::parse(&disk.file.bytes, Path::new("j")).unwrap();
            // Where the line feed alone is missing, the next write's makes the record whole.
            let is_torn = (1..progress(1).len() - 1).contains(&room);
            assert_eq!((log.progress.n_acked, log.n_damaged), (2, usize::from(is_torn)), "{room}");
        }
    }

    #[test]
    fn a_journal_is_appended_to_across_a_torn_end_and_is_its_owner_s_alone() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j.journal");
        let records = super::super::tests::first_records();
        drop(Journal::create(&path, &records).unwrap());
        let mut bytes = std::fs::read(&path).unwrap();
        bytes.extend_from_slice(&progress(5)[..20]);
        std::fs::write(&path, bytes).unwrap();
        let journal = Journal::append_to(&path).unwrap();
        assert!(journal.append(&Record::Progress(Progress { n_acked: 7, ..Progress::default() })));
        journal.flush();
        let log = Log::read(&path).unwrap();
        assert_eq!((log.progress.n_acked, log.n_damaged), (7, 1));
        use std::os::unix::fs::PermissionsExt;
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    }

    #[test]
    fn a_disk_that_has_no_room_takes_progress_all_the_same() {
        let mut bytes = super::super::tests::begun();
        let slots_at = bytes.len() as u64;
        bytes.extend(vec![b'\n'; usize::try_from(N_SLOTS).unwrap() * SLOT_BYTES]);
        let n_bytes = bytes.len();
        let mut disk = disk(FullDisk { bytes, rooms: std::iter::repeat_n(0, 1000).collect() });
        disk.next_slot = Some((slots_at, 0));
        for n in 1..100 {
            disk.progress(Some((at(n), now())));
            let log = Log::parse(&disk.file.bytes, Path::new("j")).unwrap();
            assert_eq!((log.progress.n_acked, log.n_damaged, disk.file.bytes.len()), (n, 0, n_bytes));
        }
        assert!(disk.failure.lock().unwrap().is_none());
        // The power fails in the middle of a line.
        let last = disk.next_slot.unwrap();
        let torn = encode_slot(&Record::Progress(at(100))).unwrap();
        disk.file.write_over(&torn[..60], last.0 + last.1 * SLOT_BYTES as u64).unwrap();
        let log = Log::parse(&disk.file.bytes, Path::new("j")).unwrap();
        assert_eq!((log.progress.n_acked, log.n_damaged), (99, 1));
    }

    #[test]
    fn a_journal_stays_as_long_as_it_is_and_each_session_begins_one_anew() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j.journal");
        let records = super::super::tests::first_records();
        let journal = Journal::create(&path, &records[..2]).unwrap();
        let mut lengths = Vec::new();
        for n_before in 0..3 {
            let track = super::super::Track { n_before, ..super::super::Track::default() };
            assert!(journal.append(&Record::Session(track)));
            for n in 1..30 {
                assert!(journal.append(&Record::Progress(at(n + 100 * n_before))));
                journal.flush();
            }
            let log = Log::read(&path).unwrap();
            assert_eq!(
                (log.track.n_before, log.progress.n_acked, log.n_damaged),
                (n_before, 29 + 100 * n_before, 0)
            );
            lengths.push(std::fs::metadata(&path).unwrap().len());
        }
        assert!(lengths[2] < lengths[1] + 10 && lengths[2] < 6000, "{lengths:?}");
        let log = Log::read(&path).unwrap();
        assert!(log.progress.delay_s > 0.0 && log.progress.delay_s < 60.0, "{log:?}");
        assert!(journal.append(&Record::End(super::super::Ending::Finished)));
        journal.flush();
        assert_eq!(Log::read(&path).unwrap().end, Some(super::super::Ending::Finished));
    }

    #[test]
    fn every_record_of_progress_fits_its_line() {
        let far = Progress {
            t_s: 1e9 + 0.123,
            number: u64::MAX,
            n_sent: u64::MAX,
            n_acked: u64::MAX,
            n_certain: u64::MAX,
            n_prelude: u64::MAX,
            n_begun: u64::MAX,
            begun_s: 1e9 + 0.123,
            is_away: true,
            delay_s: 1e9 + 0.123,
            z_allowed_to: Some(u64::MAX),
            hotend_c: Some([-273.123_456; 2]),
            bed_c: Some([-273.123_456; 2]),
        };
        assert!(encode_slot(&Record::Progress(far)).is_some());
    }

    #[test]
    fn nothing_but_a_journal_is_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j.journal");
        std::fs::write(&path, "my notes\n").unwrap();
        let error = Journal::create(&path, &[]).unwrap_err();
        assert!(error.to_string().contains("found a file that is no print journal"), "{error}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "my notes\n");
        std::fs::write(&path, "lumenfab pri").unwrap();
        assert!(Journal::create(&path, &[]).is_ok(), "one that broke off at once is replaced");
        assert!(Journal::create(dir.path(), &[]).is_err());
    }
}
