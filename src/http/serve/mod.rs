//! The server's edge: sockets, limits, a graceful end.
//!
//! The Unix socket is its owner's alone (rights 600): who can open it may do everything, and is named by the user's name. A TCP address is
//! opened only where keys exist, and only on this machine's own addresses as long as there is no TLS. A connection has
//! [`Edge::header_time`] for the head of a request, idle or not, and is closed when it takes nothing for [`Edge::stall_time`].
//! At the end no new ones are accepted, streams of events end, and requests under way have [`Edge::grace`].

mod socket;
mod stall;

pub use socket::BindError;

use super::Appliance;
use super::access::Peer;
use super::keys::Keys;
use super::router;
use crate::store::{self, Store};
use axum::Router;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use socket::{Accept, Socket};
use stall::Stall;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpListener;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::JoinSet;

/// What a connection may hold of a request's head, bytes.
const MAX_HEAD: usize = 1 << 16;
/// How long accepting rests after it failed: most often there are no file descriptors left.
const REST: Duration = Duration::from_millis(100);

/// Where to listen.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Listen {
    /// Path of the Unix socket.
    pub socket: Option<PathBuf>,
    /// Addresses.
    pub tcp: Vec<SocketAddr>,
}

/// Limits of the edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// Time for the head of a request, and between two requests.
    pub header_time: Duration,
    /// Longest time in which a reader takes nothing of its answer.
    pub stall_time: Duration,
    /// Time for requests under way at the end.
    pub grace: Duration,
    /// Connections at once, for the socket and for each address.
    pub max_connections: usize,
}

impl Default for Edge {
    fn default() -> Self {
        Self {
            header_time: Duration::from_secs(15),
            stall_time: Duration::from_secs(30),
            grace: Duration::from_secs(10),
            max_connections: 256,
        }
    }
}

/// What is open.
#[derive(Debug)]
pub struct Listeners {
    socket: Option<Socket>,
    tcp: Vec<TcpListener>,
}

impl Listeners {
    /// Opens everything, or nothing.
    ///
    /// # Errors
    /// [`BindError`].
    pub async fn bind(listen: &Listen, keys: &Keys) -> Result<Self, BindError> {
        let mut tcp = Vec::new();
        for &address in &listen.tcp {
            tcp.push(socket::bind_tcp(address, keys).await?);
        }
        let socket = match &listen.socket {
            Some(path) => Some(Socket::bind(path).await?),
            None => None,
        };
        Ok(Self { socket, tcp })
    }

    /// The socket's path.
    #[must_use]
    pub fn path(&self) -> Option<&Path> {
        self.socket.as_ref().map(Socket::path)
    }

    /// The addresses as they are, where a port of 0 was asked for.
    #[must_use]
    pub fn addresses(&self) -> Vec<SocketAddr> {
        self.tcp.iter().filter_map(|listener| listener.local_addr().ok()).collect()
    }
}

/// Why the faces ended before they were asked to.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The queue cannot even be read.
    #[error(transparent)]
    Store(#[from] store::Error),
    /// A part of them has ended by itself.
    #[error(
        "a part of the API has ended by itself: this is a fault of lumenfab; look into its log, and report it"
    )]
    Part,
}

/// Serves until `shutdown`, then ends gracefully.
///
/// # Errors
/// [`ServeError`].
pub async fn serve<S: Store>(
    listeners: Listeners,
    app: Appliance<S>,
    edge: Edge,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ServeError> {
    let at = app.store.head().await?.seq;
    let (end, ending) = watch::channel(false);
    let gate = Gate { router: router(app.clone()), edge, ending };
    let mut tidying = JoinSet::new();
    match app.files.jobs() {
        Ok(found) => {
            let (files, store) = (app.files.clone(), app.store.clone());
            tidying.spawn(async move { files.tidy(&store, found).await });
        }
        Err(error) => tracing::warn!("server: the folder of files cannot be read: {error}"),
    }
    app.events.begin();
    if let Some(cases) = &app.cases {
        cases.begin();
    }
    let (events, told) = (app.events.clone(), app.clone());
    let mut parts = JoinSet::new();
    parts.spawn(async move { events.tell(&told, at).await });
    for listener in listeners.tcp {
        parts.spawn(gate.clone().accept_all(listener));
    }
    if let Some(socket) = listeners.socket {
        parts.spawn(gate.accept_all(socket));
    }
    let ended_early = tokio::select! {
        () = shutdown => None,
        ended = parts.join_next() => ended,
    };
    end.send_replace(true);
    app.events.end();
    if let Some(cases) = &app.cases {
        cases.end();
    }
    let is_whole = ended_early.is_none();
    let mut panics: Vec<_> = ended_early.and_then(Result::err).into_iter().collect();
    for set in [&mut parts, &mut tidying] {
        while let Some(ended) = set.join_next().await {
            panics.extend(ended.err());
        }
    }
    for panicked in panics {
        tracing::error!("server: {panicked}");
    }
    if is_whole { Ok(()) } else { Err(ServeError::Part) }
}

/// Once the server ends.
async fn ended(ending: &mut watch::Receiver<bool>) {
    // Where the sender is gone, it has ended, too.
    ending.wait_for(|&is_ending| is_ending).await.ok();
}

/// What each listener needs.
#[derive(Clone)]
struct Gate {
    router: Router,
    edge: Edge,
    ending: watch::Receiver<bool>,
}

impl Gate {
    async fn accept_all(self, listener: impl Accept) {
        let room = Arc::new(Semaphore::new(self.edge.max_connections));
        let mut connections = JoinSet::new();
        let mut ending = self.ending.clone();
        loop {
            tokio::select! {
                () = self.accept(&listener, &room, &mut connections) => {}
                () = ended(&mut ending) => break,
            }
            while connections.try_join_next().is_some() {}
        }
        drop(listener);
        let all_ended = async { while connections.join_next().await.is_some() {} };
        if tokio::time::timeout(self.edge.grace, all_ended).await.is_err() {
            tracing::warn!("server: requests that did not end in time were broken off");
        }
    }

    /// The next connection, as soon as there is room for one.
    async fn accept(&self, listener: &impl Accept, room: &Arc<Semaphore>, connections: &mut JoinSet<()>) {
        let Ok(permit) = Arc::clone(room).acquire_owned().await else { return };
        match listener.accept().await {
            Ok((io, peer)) => drop(connections.spawn(self.clone().serve(io, peer, permit))),
            Err(error) => {
                tracing::warn!("server: a connection was not accepted: {error}");
                tokio::time::sleep(REST).await;
            }
        }
    }

    async fn serve(
        mut self,
        io: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
        peer: Peer,
        _permit: OwnedSemaphorePermit,
    ) {
        let router = TowerToHyperService::new(self.router);
        let service = service_fn(move |mut request: hyper::Request<hyper::body::Incoming>| {
            request.extensions_mut().insert(peer.clone());
            router.call(request)
        });
        let mut connection = std::pin::pin!(
            http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(self.edge.header_time)
                .max_buf_size(MAX_HEAD)
                .serve_connection(TokioIo::new(Stall::new(io, self.edge.stall_time)), service)
        );
        let ended = tokio::select! {
            ended = connection.as_mut() => ended,
            () = ended(&mut self.ending) => {
                connection.as_mut().graceful_shutdown();
                connection.await
            }
        };
        // A client that breaks off is no news.
        if let Err(error) = ended {
            tracing::debug!("server: a connection ended: {error}");
        }
    }
}
