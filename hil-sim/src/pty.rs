//! The pseudo-terminal and the symbolic link to it.
//!
//! The simulator holds the master side, raw and non-blocking; the host opens the other by the link. Whether somebody has
//! it open shows as the absence of a hang-up on the master, for which the other side is opened and closed once at the
//! beginning.

use crate::Error;
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    fs::{Mode, OFlags, fcntl_getfl, fcntl_setfl},
    io::Errno,
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
    termios::{OptionalActions, tcgetattr, tcsetattr},
};
use std::{
    fs, io,
    os::{fd::OwnedFd, unix::fs::symlink},
    path::{Path, PathBuf},
    time::Duration,
};

/// What the master side shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ready {
    /// There are bytes to read.
    pub readable: bool,
    /// Nobody has the other side open.
    pub hung_up: bool,
}

/// What came of an attempt to read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Read {
    /// So many bytes.
    Bytes(usize),
    /// Nothing at present.
    Nothing,
    /// Nothing, and nobody is there.
    HungUp,
}

/// An open pseudo-terminal with its link.
#[derive(Debug)]
pub struct Pty {
    master: OwnedFd,
    /// The other side, for example `/dev/pts/3`.
    pub device: PathBuf,
    link: PathBuf,
}

impl Pty {
    /// Opens a pseudo-terminal and makes `link` point to it.
    ///
    /// # Errors
    /// [`Error::LinkTaken`] where there is something other than a stale link; [`Error::Io`].
    pub fn open(link: &Path) -> Result<Self, Error> {
        refuse_taken(link)?;
        let fail = |error: Errno| Error::io("open a pseudo-terminal for", link, error);
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).map_err(fail)?;
        grantpt(&master).map_err(fail)?;
        unlockpt(&master).map_err(fail)?;
        let name = ptsname(&master, Vec::new()).map_err(fail)?;
        let device = PathBuf::from(name.to_string_lossy().into_owned());
        let flags = fcntl_getfl(&master).map_err(fail)?;
        fcntl_setfl(&master, flags | OFlags::NONBLOCK).map_err(fail)?;
        let other = rustix::fs::open(&device, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())
            .map_err(fail)?;
        let mut settings = tcgetattr(&other).map_err(fail)?;
        settings.make_raw();
        tcsetattr(&other, OptionalActions::Now, &settings).map_err(fail)?;
        drop(other);
        replace_link(&device, link).map_err(|error| Error::io("link", link, error))?;
        Ok(Self { master, device, link: link.to_owned() })
    }

    /// Waits until there is something to read, there is room to write (if `writing`), or `timeout` is over.
    ///
    /// # Errors
    /// What the system says; an interruption by a signal is no error.
    pub fn wait(&self, writing: bool, timeout: Duration) -> io::Result<Ready> {
        let wanted = if writing { PollFlags::IN | PollFlags::OUT } else { PollFlags::IN };
        let mut fds = [PollFd::new(&self.master, wanted)];
        match poll(&mut fds, Some(&timespec(timeout))) {
            Ok(_) | Err(Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
        let seen = fds[0].revents();
        Ok(Ready { readable: seen.contains(PollFlags::IN), hung_up: seen.contains(PollFlags::HUP) })
    }

    /// Reads what is there.
    ///
    /// # Errors
    /// What the system says, other than that nothing or nobody is there.
    pub fn read(&self, buffer: &mut [u8]) -> io::Result<Read> {
        match rustix::io::read(&self.master, buffer) {
            Ok(0) | Err(Errno::IO) => Ok(Read::HungUp),
            Ok(n) => Ok(Read::Bytes(n)),
            Err(Errno::AGAIN | Errno::INTR) => Ok(Read::Nothing),
            Err(error) => Err(error.into()),
        }
    }

    /// Writes what there is room for; the number of bytes.
    ///
    /// # Errors
    /// What the system says, other than that there is no room or nobody.
    pub fn write(&self, bytes: &[u8]) -> io::Result<usize> {
        match rustix::io::write(&self.master, bytes) {
            Ok(n) => Ok(n),
            Err(Errno::AGAIN | Errno::INTR) => Ok(0),
            // Nobody is there to read it.
            Err(Errno::IO) => Ok(bytes.len()),
            Err(error) => Err(error.into()),
        }
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        // Somebody else may have put something there in the meantime; a link that cannot be removed is stale anyway.
        if fs::read_link(&self.link).is_ok_and(|target| target == self.device) {
            drop(fs::remove_file(&self.link));
        }
    }
}

/// Waits without a terminal.
///
/// # Errors
/// What the system says; an interruption by a signal is no error.
pub fn pause(timeout: Duration) -> io::Result<()> {
    match poll(&mut [], Some(&timespec(timeout))) {
        Ok(_) | Err(Errno::INTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

fn timespec(duration: Duration) -> Timespec {
    Timespec {
        tv_sec: i64::try_from(duration.as_secs()).unwrap_or(i64::MAX),
        tv_nsec: duration.subsec_nanos().into(),
    }
}

fn refuse_taken(link: &Path) -> Result<(), Error> {
    let found = match fs::symlink_metadata(link) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(Error::io("look at", link, error)),
        // A link whose target is gone is what a killed simulator leaves.
        Ok(there) if there.is_symlink() && !link.exists() => return Ok(()),
        Ok(there) if there.is_symlink() => "a link to something that exists",
        Ok(there) if there.is_dir() => "a directory",
        Ok(_) => "a file",
    };
    Err(Error::LinkTaken { path: link.to_owned(), found })
}

/// Makes `link` point to `device` in one step.
fn replace_link(device: &Path, link: &Path) -> io::Result<()> {
    let mut draft = link.as_os_str().to_owned();
    draft.push(format!(".{}.new", std::process::id()));
    let draft = PathBuf::from(draft);
    match fs::remove_file(&draft) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    symlink(device, &draft)?;
    fs::rename(&draft, link)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read as _, Write as _};

    #[test]
    fn bytes_pass_unchanged_both_ways_and_the_link_goes_in_the_end() {
        let dir = tempfile::tempdir().unwrap();
        let link = dir.path().join("printer");
        let pty = Pty::open(&link).unwrap();
        assert!(pty.wait(false, Duration::ZERO).unwrap().hung_up);
        let mut host = fs::OpenOptions::new().read(true).write(true).open(&link).unwrap();
        assert!(!pty.wait(false, Duration::ZERO).unwrap().hung_up);
        host.write_all(b"G28\r\x03\n").unwrap();
        assert!(pty.wait(false, Duration::from_secs(1)).unwrap().readable);
        let mut buffer = [0; 64];
        assert_eq!(pty.read(&mut buffer).unwrap(), Read::Bytes(6));
        assert_eq!(&buffer[..6], b"G28\r\x03\n");
        assert_eq!(pty.read(&mut buffer).unwrap(), Read::Nothing);
        assert_eq!(pty.write(b"ok\n").unwrap(), 3);
        host.read_exact(&mut buffer[..3]).unwrap();
        assert_eq!(&buffer[..3], b"ok\n");
        drop(host);
        assert_eq!(pty.read(&mut buffer).unwrap(), Read::HungUp);
        drop(pty);
        assert!(fs::symlink_metadata(&link).is_err());
    }

    #[test]
    fn stale_link_is_replaced_and_anything_else_refused() {
        let dir = tempfile::tempdir().unwrap();
        let stale = dir.path().join("stale");
        symlink(dir.path().join("gone"), &stale).unwrap();
        drop(Pty::open(&stale).unwrap());
        let file = dir.path().join("file");
        fs::write(&file, "").unwrap();
        let live = dir.path().join("live");
        symlink(&file, &live).unwrap();
        for (path, found) in
            [(dir.path(), "a directory"), (&file, "a file"), (&live, "a link to something that exists")]
        {
            let message = Pty::open(path).unwrap_err().to_string();
            assert!(message.contains(found), "{message}");
        }
    }
}
