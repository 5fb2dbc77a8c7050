//! Calls about cases.

use super::{Client, Error};
use crate::http::wire::case::{
    Begun, CaseJob, CaseList, CaseToQueue, CaseView, FolderList, FolderPath, FolderView, Handle, NewCase,
    SeriesBody, StagesBody, TaskList, TaskView, VolumeView,
};
use hyper::Method;
use hyper::body::Bytes;

/// Every call fails with [`Error`]: no server, no answer, or the server's refusal.
impl Client {
    /// The folders that CTs lie below; or, of a folder, those in it.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn folders(&self, within: Option<&Handle>) -> Result<FolderList, Error> {
        let within = within.map(|folder| format!("/{folder}")).unwrap_or_default();
        self.get(&format!("/api/v1/folders{within}")).await
    }

    /// A folder by its path on the server's disk.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn find_folder(&self, path: &FolderPath) -> Result<FolderView, Error> {
        self.send(Method::POST, "/api/v1/folders", path).await
    }

    /// Finds the series of a folder.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn inspect(&self, folder: &Handle) -> Result<TaskView, Error> {
        self.send(Method::POST, &format!("/api/v1/folders/{folder}/inspection"), &()).await
    }

    /// Reads a series, so that its planes can be looked at.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn read_volume(&self, folder: &Handle, series: &SeriesBody) -> Result<TaskView, Error> {
        self.send(Method::POST, &format!("/api/v1/folders/{folder}/volume"), series).await
    }

    /// The geometry of a volume.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn volume(&self, volume: &Handle) -> Result<VolumeView, Error> {
        self.get(&format!("/api/v1/volumes/{volume}")).await
    }

    /// A plane of a volume as PNG, across `x`, `y` or `z`, within a window of HU.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn plane(
        &self,
        volume: &Handle,
        (across, index): (char, usize),
        [low_hu, high_hu]: [f32; 2],
    ) -> Result<Bytes, Error> {
        let query = format!("across={across}&low_hu={low_hu}&high_hu={high_hu}");
        self.bytes(&format!("/api/v1/volumes/{volume}/planes/{index}?{query}")).await
    }

    /// Tasks: those under way, and the last ones that are over.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn tasks(&self) -> Result<TaskList, Error> {
        self.get("/api/v1/tasks").await
    }

    /// A task.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn task(&self, task: &Handle) -> Result<TaskView, Error> {
        self.get(&format!("/api/v1/tasks/{task}")).await
    }

    /// Ends a task.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn cancel_task(&self, task: &Handle) -> Result<TaskView, Error> {
        self.send(Method::DELETE, &format!("/api/v1/tasks/{task}"), &()).await
    }

    /// All cases.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn cases(&self) -> Result<CaseList, Error> {
        self.get("/api/v1/cases").await
    }

    /// A case.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn case(&self, case: &Handle) -> Result<CaseView, Error> {
        self.get(&format!("/api/v1/cases/{case}")).await
    }

    /// Removes a case for good.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn remove_case(&self, case: &Handle) -> Result<(), Error> {
        self.way.call(Method::DELETE, &format!("/api/v1/cases/{case}"), None).await
    }

    /// Begins a case.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn begin_case(&self, new: &NewCase) -> Result<Begun, Error> {
        self.send(Method::POST, "/api/v1/cases", new).await
    }

    /// Does stages of a case, with corrections.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn do_stages(&self, case: &Handle, stages: &StagesBody) -> Result<TaskView, Error> {
        self.send(Method::POST, &format!("/api/v1/cases/{case}/stages"), stages).await
    }

    /// A document or picture of a case.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn case_file(&self, case: &Handle, name: &str) -> Result<Bytes, Error> {
        self.bytes(&format!("/api/v1/cases/{case}/files/{name}")).await
    }

    /// Adds a job of a case.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn queue_case(&self, case: &Handle, job: &CaseToQueue) -> Result<CaseJob, Error> {
        self.send(Method::POST, &format!("/api/v1/cases/{case}/jobs"), job).await
    }
}
