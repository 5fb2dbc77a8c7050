//! One request over one connection (IO).

use super::Error;
use crate::http::wire::ErrorBody;
use http_body_util::combinators::BoxBody;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::client::conn::http1;
use hyper::{Method, Request, Response, StatusCode, header};
use hyper_util::rt::TokioIo;
use serde::de::DeserializeOwned;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpStream, UnixStream};

/// How long an answer may take.
const PATIENCE: Duration = Duration::from_secs(30);
/// Longest answer, bytes.
const MAX_ANSWER: usize = 64 << 20;

/// A body that is sent.
pub(super) type Sent = BoxBody<Bytes, io::Error>;

/// Where the server is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Place {
    Socket(PathBuf),
    Tcp(SocketAddr),
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Socket(path) => path.display().fmt(f),
            Self::Tcp(address) => address.fmt(f),
        }
    }
}

/// The way to the server.
#[derive(Clone, PartialEq, Eq)]
pub(super) struct Way {
    pub(super) place: Place,
    pub(super) key: Option<String>,
}

impl std::fmt::Debug for Way {
    /// Without the key.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Way").field("place", &self.place).finish_non_exhaustive()
    }
}

/// A body that is there already.
pub(super) fn whole(bytes: impl Into<Bytes>) -> Sent {
    Full::new(bytes.into()).map_err(|never| match never {}).boxed()
}

impl Way {
    /// A request with what it always has.
    pub(super) fn request(&self, method: Method, path: &str) -> hyper::http::request::Builder {
        let host = match &self.place {
            Place::Socket(_) => "localhost".to_owned(),
            Place::Tcp(address) => address.to_string(),
        };
        let request = Request::builder().method(method).uri(path).header(header::HOST, host);
        match &self.key {
            Some(key) => request.header("x-api-key", key),
            None => request,
        }
    }

    /// Sends it; the answer's head has come. `patience`: `None` for as long as it takes.
    pub(super) async fn send(
        &self,
        request: hyper::http::Result<Request<Sent>>,
        patience: Option<Duration>,
    ) -> Result<Response<Incoming>, Error> {
        let request = request.map_err(|e| self.unreachable(&e))?;
        let answered = async {
            match &self.place {
                Place::Socket(path) => self.exchange(UnixStream::connect(path).await, request).await,
                Place::Tcp(address) => self.exchange(TcpStream::connect(address).await, request).await,
            }
        };
        match patience {
            Some(patience) => self.in_time(patience, answered).await?,
            None => answered.await,
        }
    }

    pub(super) async fn in_time<T>(
        &self,
        patience: Duration,
        work: impl Future<Output = T>,
    ) -> Result<T, Error> {
        let late = |_late| Error::Late { place: self.place.to_string(), waited_s: patience.as_secs() };
        tokio::time::timeout(patience, work).await.map_err(late)
    }

    async fn exchange(
        &self,
        io: io::Result<impl AsyncRead + AsyncWrite + Unpin + Send + 'static>,
        request: Request<Sent>,
    ) -> Result<Response<Incoming>, Error> {
        let io = io.map_err(|e| self.not_connected(&e))?;
        let (mut sender, connection) =
            http1::handshake(TokioIo::new(io)).await.map_err(|e| self.unreachable(&e))?;
        // It ends with the answer's body; what goes wrong with it shows there.
        tokio::spawn(async move { connection.await.ok() });
        sender.send_request(request).await.map_err(|e| self.unreachable(&e))
    }

    fn not_connected(&self, error: &io::Error) -> Error {
        match (&self.place, error.kind()) {
            (Place::Socket(path), io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused) => {
                Error::NoServer { path: path.clone() }
            }
            (Place::Socket(path), io::ErrorKind::PermissionDenied) => Error::NotYours { path: path.clone() },
            _ => self.unreachable(error),
        }
    }

    pub(super) fn unreachable(&self, problem: &dyn std::fmt::Display) -> Error {
        Error::Unreachable { place: self.place.to_string(), problem: problem.to_string() }
    }

    fn not_lumenfab(&self, problem: &dyn std::fmt::Display) -> Error {
        Error::NotLumenfab { place: self.place.to_string(), problem: problem.to_string() }
    }

    /// The whole body, or what the server refuses.
    pub(super) async fn body(&self, response: Response<Incoming>) -> Result<Bytes, Error> {
        let status = response.status();
        let body = Limited::new(response.into_body(), MAX_ANSWER).collect();
        let body = self.in_time(PATIENCE, body).await?.map_err(|e| self.unreachable(&e))?.to_bytes();
        if status.is_success() { Ok(body) } else { Err(self.refused(status, &body)) }
    }

    fn refused(&self, status: StatusCode, body: &[u8]) -> Error {
        match serde_json::from_slice::<ErrorBody>(body) {
            Ok(ErrorBody { error: fault }) => Error::Refused { status: status.as_u16(), fault },
            Err(_other_shape) => self.not_lumenfab(&format_args!("status {status}")),
        }
    }

    /// Asks for something in JSON.
    pub(super) async fn call<T: DeserializeOwned>(
        &self,
        method: Method,
        path: &str,
        body: Option<Vec<u8>>,
    ) -> Result<T, Error> {
        let bytes = self.bytes(method, path, body).await?;
        // An empty answer is JSON's nothing.
        let text: &[u8] = if bytes.is_empty() { b"null" } else { &bytes };
        serde_json::from_slice(text).map_err(|e| self.not_lumenfab(&e))
    }

    pub(super) async fn bytes(
        &self,
        method: Method,
        path: &str,
        body: Option<Vec<u8>>,
    ) -> Result<Bytes, Error> {
        let mut request = self.request(method, path);
        if body.is_some() {
            request = request.header(header::CONTENT_TYPE, "application/json");
        }
        let request = request.body(whole(body.unwrap_or_default()));
        let response = self.send(request, Some(PATIENCE)).await?;
        self.body(response).await
    }
}
