//! Opening what is listened to.

use super::super::access::Peer;
use super::super::keys::Keys;
use crate::queue::Name;
use std::fs::{File, Permissions, TryLockError};
use std::io;
use std::net::SocketAddr;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream, UnixListener, UnixStream};

/// How long whoever may listen at the socket is given to answer.
const PATIENCE: Duration = Duration::from_secs(1);

/// Why something cannot be listened to.
#[derive(Debug, thiserror::Error)]
pub enum BindError {
    /// Another server lives there.
    #[error("{}: another lumenfab serves this socket: stop it first, or name another state directory", path.display())]
    InUse {
        /// The socket.
        path: PathBuf,
    },
    /// There is something else.
    #[error("{}: found a file that is no socket: move it away, or name another state directory", path.display())]
    NotASocket {
        /// The path.
        path: PathBuf,
    },
    /// Nobody could be let in.
    #[error("{address}: a TCP address is served only where keys exist: make one first")]
    NoKeys {
        /// The address.
        address: SocketAddr,
    },
    /// Keys would go over the network in the clear.
    #[error(
        "{address}: an address that others can reach needs TLS: use one of this machine alone, such as 127.0.0.1, behind a server that does TLS"
    )]
    NoTls {
        /// The address.
        address: SocketAddr,
    },
    /// The system refuses.
    #[error("{place}: {source}")]
    Io {
        /// Path or address.
        place: String,
        /// Why.
        source: io::Error,
    },
}

pub(super) async fn bind_tcp(address: SocketAddr, keys: &Keys) -> Result<TcpListener, BindError> {
    if keys.is_empty() {
        return Err(BindError::NoKeys { address });
    }
    if !address.ip().to_canonical().is_loopback() {
        return Err(BindError::NoTls { address });
    }
    let failed = |source| BindError::Io { place: address.to_string(), source };
    TcpListener::bind(address).await.map_err(failed)
}

/// A Unix socket, its owner's alone; its file goes when this is dropped.
#[derive(Debug)]
pub(super) struct Socket {
    listener: UnixListener,
    path: PathBuf,
    /// Held as long as this process lives: whoever cannot have it knows that somebody does.
    _lock: File,
}

impl Socket {
    /// Opens it; one that a dead process left is replaced.
    pub(super) async fn bind(path: &Path) -> Result<Self, BindError> {
        let failed = |source| BindError::Io { place: path.display().to_string(), source };
        let lock = locked(path)?;
        check_free(path).await?;
        // Under another name until its rights are right: nobody else can open it even for a moment.
        let fresh = path.with_extension("new");
        remove(&fresh).map_err(failed)?;
        let listener = UnixListener::bind(&fresh).map_err(failed)?;
        std::fs::set_permissions(&fresh, Permissions::from_mode(0o600)).map_err(failed)?;
        std::fs::rename(&fresh, path).map_err(failed)?;
        Ok(Self { listener, path: path.to_owned(), _lock: lock })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        if let Err(error) = remove(&self.path) {
            tracing::warn!("server: the socket's file stays: {error}");
        }
    }
}

fn remove(path: &Path) -> io::Result<()> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
        done => done,
    }
}

fn locked(path: &Path) -> Result<File, BindError> {
    let failed = |source| BindError::Io { place: path.display().to_string(), source };
    let mut options = File::options();
    options.create(true).truncate(false).write(true).mode(0o600);
    let file = options.open(path.with_extension("lock")).map_err(failed)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(BindError::InUse { path: path.to_owned() }),
        Err(TryLockError::Error(source)) => Err(failed(source)),
    }
}

/// Nothing is there, or a socket at which nobody listens.
async fn check_free(path: &Path) -> Result<(), BindError> {
    let in_use = || BindError::InUse { path: path.to_owned() };
    match std::fs::symlink_metadata(path) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(()),
        Ok(found) if !found.file_type().is_socket() => {
            return Err(BindError::NotASocket { path: path.to_owned() });
        }
        _ => {}
    }
    match tokio::time::timeout(PATIENCE, UnixStream::connect(path)).await {
        Ok(Err(e)) if e.kind() == io::ErrorKind::ConnectionRefused => Ok(()),
        Ok(Err(source)) => Err(BindError::Io { place: path.display().to_string(), source }),
        Ok(Ok(_)) | Err(_) => Err(in_use()),
    }
}

/// Where connections come from.
pub(super) trait Accept: Send + 'static {
    /// A connection.
    type Io: AsyncRead + AsyncWrite + Unpin + Send + 'static;

    /// The next one, and who is at its other end.
    fn accept(&self) -> impl Future<Output = io::Result<(Self::Io, Peer)>> + Send;
}

impl Accept for TcpListener {
    type Io = TcpStream;

    async fn accept(&self) -> io::Result<(TcpStream, Peer)> {
        let (io, address) = Self::accept(self).await?;
        io.set_nodelay(true)?;
        Ok((io, Peer::Tcp(address.ip())))
    }
}

impl Accept for Socket {
    type Io = UnixStream;

    async fn accept(&self) -> io::Result<(UnixStream, Peer)> {
        let (io, _unnamed) = self.listener.accept().await?;
        let uid = io.peer_cred()?.uid();
        Ok((io, Peer::Socket(user(uid)?)))
    }
}

/// The user's name where `/etc/passwd` has it, else the number.
fn user(uid: u32) -> io::Result<Name> {
    let users = std::fs::read_to_string("/etc/passwd").unwrap_or_default();
    let named = name_in(&users, uid).and_then(|name| Name::try_new(name).ok());
    named.map_or_else(|| Name::try_new(&format!("user {uid}")).map_err(io::Error::other), Ok)
}

fn name_in(users: &str, uid: u32) -> Option<&str> {
    users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(uid)).then_some(name)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn users_are_named_as_the_system_does() {
        let users = "root:x:0:0:root:/root:/bin/bash\n\nlab:x:1000:1000:,,,:/home/lab:/bin/bash\n";
        assert_eq!(
            [name_in(users, 0), name_in(users, 1000), name_in(users, 7)],
            [Some("root"), Some("lab"), None]
        );
    }
}
