//! What the driver needs of a port.

use super::{Error, PortProblem};
use std::future::Future;
use tokio::io::{AsyncRead, AsyncWrite};

/// A port: a name for messages, and a two-way stream of bytes that may come back after it was lost.
pub trait Link {
    /// The stream.
    type Stream: AsyncRead + AsyncWrite + Unpin;

    /// What the operator calls the port.
    fn name(&self) -> &str;

    /// Opens the port; after it was lost, opens it again, but only where the same device is behind it.
    ///
    /// # Errors
    /// [`Error::Open`].
    fn open(&mut self) -> impl Future<Output = Result<Self::Stream, Error>>;
}

/// Any stream with a name, once: for tests, and for printers behind other transports.
#[derive(Debug)]
pub struct NamedLink<S> {
    name: String,
    stream: Option<S>,
}

impl<S> NamedLink<S> {
    /// A link of this name.
    pub fn new(name: &str, stream: S) -> Self {
        Self { name: name.to_owned(), stream: Some(stream) }
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> Link for NamedLink<S> {
    type Stream = S;

    fn name(&self) -> &str {
        &self.name
    }

    async fn open(&mut self) -> Result<S, Error> {
        let gone = || Error::Open { port: self.name.clone(), problem: PortProblem::Missing };
        self.stream.take().ok_or_else(gone)
    }
}
