//! What is kept on the disk of jobs that are over, and for how long; whether there is room (IO).
//!
//! The history of a job stays for good; its file and what was made of it go some days after its end, so that a server that is left
//! alone for years does not fill its disk. Case directories lie elsewhere, and are never touched.

use super::config::Disk;
use super::kit::{Kit, ended, on_disk};
use crate::http::files::Files;
use crate::queue::{JobId, State};
use crate::store::{self, Store};
use jiff::SignedDuration;
use std::collections::BTreeSet;
use std::io;
use std::path::Path;
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// How often it is looked whether there is room, and what is over.
const LOOK: Duration = Duration::from_secs(60);
const TIDY: Duration = Duration::from_secs(3600);

/// See the module.
pub(super) struct Keeper<S> {
    pub(super) kit: Kit<S>,
    pub(super) files: Files,
    pub(super) disk: Disk,
}

impl<S: Store> Keeper<S> {
    /// Until the server ends.
    ///
    /// # Errors
    /// [`store::Error::Gone`].
    pub(super) async fn run(&self) -> Result<(), store::Error> {
        let mut stopping = self.kit.stopping.clone();
        let (mut had_room, mut tidied) = (true, None::<Instant>);
        while self.kit.stopping().is_none() {
            had_room = self.look(had_room).await;
            if tidied.is_none_or(|at| at.elapsed() >= TIDY) {
                self.tidy().await?;
                tidied = Some(Instant::now());
            }
            tokio::select! {
                () = sleep(LOOK) => {}
                () = ended(&mut stopping) => {}
            }
        }
        Ok(())
    }

    /// Tells when there is no room any more, and when there is again.
    async fn look(&self, had_room: bool) -> bool {
        let has_room = has_room(&self.files).await;
        let mb = self.disk.reserve_bytes >> 20;
        if had_room && !has_room {
            let text =
                format!("less than {mb} MB are free: nothing is uploaded or prepared until there is room");
            self.kit.news.tell("disk-full", None, None, &text);
        } else if has_room && !had_room {
            self.kit.news.tell("disk-has-room", None, None, "there is room on the disk again");
        }
        has_room
    }

    /// Removes what belongs to jobs that have been over for long enough.
    async fn tidy(&self) -> Result<(), store::Error> {
        let (files, jobs) = (self.files.clone(), self.kit.layout.dir().join("jobs"));
        let kept = match on_disk(move || kept(&files, &jobs)).await {
            Ok(kept) => kept,
            Err(error) => {
                tracing::warn!("disk: what is kept cannot be listed: {}", error.kind());
                return Ok(());
            }
        };
        let mut n_removed = 0;
        for id in kept {
            match self.kit.store.job(id).await {
                Ok((job, _claim))
                    if is_old(job.state, self.kit.now().duration_since(job.changed), self.disk.keep) =>
                {
                    n_removed += u32::from(self.remove(id).await);
                }
                Err(store::Error::Gone) => return Err(store::Error::Gone),
                // One that is not known may be of a newer backup, and is nobody's to remove.
                _ => {}
            }
        }
        if n_removed > 0 {
            tracing::info!(n_removed, "disk: what was kept of jobs that are over was removed");
        }
        Ok(())
    }

    async fn remove(&self, id: JobId) -> bool {
        let (files, dir) = (self.files.clone(), self.kit.layout.job(id));
        let removed = on_disk(move || {
            match std::fs::remove_dir_all(dir) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
            files.remove(id)
        });
        let removed = removed.await;
        if let Err(error) = &removed {
            tracing::warn!(job = %id, "disk: what was kept of it cannot be removed: {}", error.kind());
        }
        removed.is_ok()
    }
}

/// Whether something may be uploaded or prepared. Where nobody knows, it is tried.
pub(super) async fn has_room(files: &Files) -> bool {
    let files = files.clone();
    on_disk(move || files.free_bytes()).await.map_or(true, |free| free > 0)
}

/// Jobs of which something lies on the disk.
fn kept(files: &Files, jobs: &Path) -> io::Result<BTreeSet<JobId>> {
    let mut kept: BTreeSet<_> = files.jobs()?.into_iter().map(|(id, _)| id).collect();
    for entry in std::fs::read_dir(jobs)? {
        kept.extend(entry?.file_name().to_str().and_then(|name| name.parse::<JobId>().ok()));
    }
    Ok(kept)
}

/// Whether a job that changed so long ago has been over for longer than that.
fn is_old(state: State, age: SignedDuration, keep: Duration) -> bool {
    state.is_over() && age > SignedDuration::try_from(keep).unwrap_or(SignedDuration::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::tests::id;

    #[test]
    fn a_job_is_old_some_time_after_its_end_and_never_before() {
        let is_old = |state, age_s| is_old(state, SignedDuration::from_secs(age_s), Duration::from_secs(100));
        for state in [State::Finished, State::Failed, State::Cancelled] {
            assert!(!is_old(state, 100) && is_old(state, 101), "{state}");
            assert!(!is_old(state, -1000), "the clock was set back");
        }
        for state in
            [State::Draft, State::Queued, State::Paused, State::AwaitingBedClear, State::AwaitingSignOff]
        {
            assert!(!is_old(state, 1_000_000), "{state}");
        }
    }

    #[test]
    fn what_is_kept_of_a_job_is_found_wherever_it_lies() {
        let dir = tempfile::tempdir().unwrap();
        let files = Files::open(&dir.path().join("files"), Default::default()).unwrap();
        let jobs = dir.path().join("jobs");
        std::fs::create_dir_all(jobs.join(id(2).to_string())).unwrap();
        std::fs::create_dir_all(jobs.join("other")).unwrap();
        for number in [1, 2] {
            std::fs::write(dir.path().join(format!("files/{}.gcode", id(number))), "G28\n").unwrap();
        }
        assert_eq!(kept(&files, &jobs).unwrap(), BTreeSet::from([id(1), id(2)]));
    }
}
