//! What the driver needs of a port.

use tokio::io::{AsyncRead, AsyncWrite};

/// A two-way stream of bytes with a name for messages.
pub trait Link {
    /// The stream.
    type Stream: AsyncRead + AsyncWrite + Unpin;

    /// What the operator calls the port.
    fn name(&self) -> &str;

    /// Gives the stream to the driver.
    fn into_stream(self) -> Self::Stream;
}

/// Any stream with a name: for tests, and for printers behind other transports.
#[derive(Debug)]
pub struct NamedLink<S> {
    /// What the operator calls it.
    pub name: String,
    /// The stream.
    pub stream: S,
}

impl<S: AsyncRead + AsyncWrite + Unpin> Link for NamedLink<S> {
    type Stream = S;

    fn name(&self) -> &str {
        &self.name
    }

    fn into_stream(self) -> S {
        self.stream
    }
}
