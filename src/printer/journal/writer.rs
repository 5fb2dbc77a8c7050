//! The thread that owns the journal's file (IO).
//!
//! The streaming task hands records over and never waits: where the disk is slow, a record of progress is left out and a later
//! one says more. The thread writes and flushes each batch to the disk. A write that fails (full disk) may leave half a
//! line behind; the next one begins with a line feed, so that only that line is lost, and writing goes on once there is room.

use super::{Error, Record, encode, header};
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

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
    Append(Vec<u8>),
    /// Answered when all before it is on the disk.
    Flush(SyncSender<()>),
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
        let written = |source| Error::Io { path: path.to_owned(), action: "written", source };
        let dir = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        // Readable by its owner alone: what tempfile makes by itself.
        let mut file = tempfile::Builder::new().prefix(".lumenfab-").tempfile_in(dir).map_err(written)?;
        file.write_all(&bytes).and_then(|()| file.as_file().sync_all()).map_err(written)?;
        file.persist(path).map_err(|error| written(error.error))?;
        File::open(dir).and_then(|dir| dir.sync_all()).map_err(written)?;
        Self::append_to(path)
    }

    /// Goes on with the journal at `path`.
    ///
    /// # Errors
    /// [`Error::Io`], also where the thread cannot be started.
    pub fn append_to(path: &Path) -> Result<Self, Error> {
        let failed = |source| Error::Io { path: path.to_owned(), action: "written", source };
        let file = OpenOptions::new().append(true).read(true).mode(0o600).open(path).map_err(failed)?;
        let failure = Arc::new(Mutex::new(None));
        let (sender, orders) = sync_channel(WAITING);
        let told = Arc::clone(&failure);
        // A file that ends within a line was torn.
        let is_torn = !read(path)?.ends_with(b"\n");
        let work = move || Disk { file, is_torn, failure: told }.serve(&orders);
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
        self.sender.as_ref().is_some_and(|sender| sender.try_send(Order::Append(encode(record))).is_ok())
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

    /// Why the last record could not be written; nothing where it was. Taken: told once.
    pub fn take_failure(&self) -> Option<String> {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).take()
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

/// The file, on its own thread.
struct Disk<F> {
    file: F,
    /// It ends within a line.
    is_torn: bool,
    failure: Arc<Mutex<Option<String>>>,
}

/// A file as this thread needs it; a full disk in tests.
trait Flushed: Write {
    fn to_disk(&mut self) -> io::Result<()>;
}

impl Flushed for File {
    fn to_disk(&mut self) -> io::Result<()> {
        self.sync_data()
    }
}

impl<F: Flushed> Disk<F> {
    fn serve(mut self, orders: &Receiver<Order>) {
        while let Ok(order) = orders.recv() {
            match order {
                Order::Append(mut bytes) => {
                    let flushes = self.gather(&mut bytes, orders);
                    self.write(&bytes);
                    flushes.into_iter().for_each(answer);
                }
                Order::Flush(flush) => answer(flush),
            }
        }
    }

    /// What else waits goes to the disk with it.
    fn gather(&self, bytes: &mut Vec<u8>, orders: &Receiver<Order>) -> Vec<SyncSender<()>> {
        let mut flushes = Vec::new();
        while let Ok(order) = orders.try_recv() {
            match order {
                Order::Append(more) => bytes.extend(more),
                Order::Flush(flush) => flushes.push(flush),
            }
        }
        flushes
    }

    fn write(&mut self, bytes: &[u8]) {
        let result = self.try_write(bytes);
        if let Err(error) = result {
            let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
            failure.get_or_insert_with(|| error.to_string());
        }
    }

    fn try_write(&mut self, bytes: &[u8]) -> io::Result<()> {
        if self.is_torn {
            self.file.write_all(b"\n")?;
        }
        // Until all of it is there.
        self.is_torn = true;
        self.file.write_all(bytes)?;
        self.is_torn = false;
        self.file.to_disk()
    }
}

fn answer(flush: SyncSender<()>) {
    // Whoever asked may have gone.
    flush.send(()).ok();
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
    use crate::printer::journal::{Log, Progress};
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
        fn to_disk(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn progress(n_acked: u64) -> Vec<u8> {
        encode(&Record::Progress(Progress { n_acked, ..Progress::default() }))
    }

    #[test]
    fn a_full_disk_tears_one_record_and_is_told_and_the_next_ones_are_whole() {
        for room in 0..progress(1).len() {
            let failure = Arc::new(Mutex::new(None));
            let file = FullDisk { bytes: super::super::tests::begun(), rooms: [room].into() };
            let mut disk = Disk { file, is_torn: false, failure: Arc::clone(&failure) };
            disk.write(&progress(1));
            assert!(failure.lock().unwrap().take().is_some(), "told");
            disk.file.rooms.clear();
            disk.write(&progress(2));
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
