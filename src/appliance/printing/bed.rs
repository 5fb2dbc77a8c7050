//! What is known of a printer's bed and spool, and clearing the bed by a program.

use super::station::{Station, not_now};
use crate::appliance::clearing;
use crate::appliance::kit::ended;
use crate::queue::{Bed, Evidence, JobId, Loaded, Material, Name, Said, State};
use crate::store::{self, Store};

impl<S: Store> Station<S> {
    /// Makes the printer known to the queue, and doubts its bed where it was not watched, or was another machine's.
    pub(in crate::appliance) async fn introduce(&mut self) -> Result<(), store::Error> {
        let known = self.find().await?;
        let loaded = self.loaded(known.as_ref().and_then(|printer| printer.loaded.as_ref()));
        if known.as_ref().and_then(|printer| printer.loaded.as_ref()) != Some(&loaded) {
            self.say(Said::Loaded(loaded), "as the configuration has it").await?;
        }
        match known {
            // Its bed is made anew with each print.
            None if self.machine.is_simulated() => {
                self.say(Said::BedClear(Evidence::Sensor), "a simulated printer begins with an empty bed")
                    .await?;
            }
            None => {}
            Some(_) => {
                self.doubt_at_start();
                self.settle_doubt().await?;
            }
        }
        self.mark_watched();
        self.know();
        Ok(())
    }

    /// What it has loaded: as configured, with what the queue knows of the spool.
    fn loaded(&self, known: Option<&Loaded>) -> Loaded {
        let profile = &self.machine.profile;
        let material = |text: &str| Material::try_new(text).ok();
        let material = self.config.material.clone().or_else(|| material(&profile.filament.material));
        #[expect(clippy::cast_possible_truncation, reason = "a nozzle has some hundred micrometres")]
        let nozzle_um = (1000.0 * profile.machine.nozzle_mm).round() as u32;
        let unnamed = || Name::try_new("unnamed").expect("a name that is written here");
        let configured = Loaded {
            profile: Name::try_new(&profile.name).unwrap_or_else(|_too_long| unnamed()),
            material: material.unwrap_or_else(|| Material::try_new("PLA").expect("a material")),
            nozzle_um,
            left_mm3: None,
        };
        match known {
            // Somebody has changed the spool since: that is the queue's to know, unless the configuration says what is loaded.
            Some(known) if self.config.material.is_none() => {
                Loaded { material: known.material.clone(), left_mm3: known.left_mm3, ..configured }
            }
            Some(known) if known.material == configured.material => {
                Loaded { left_mm3: known.left_mm3, ..configured }
            }
            _ => configured,
        }
    }

    /// The program clears the bed that a server left which ended before it could be.
    pub(super) async fn clear_what_lies_there(&mut self) -> Result<(), store::Error> {
        let Some(Bed::Taken(job)) = self.find().await?.map(|printer| printer.bed) else { return Ok(()) };
        let (found, _) = self.kit.store.job(job).await?;
        if found.state == State::AwaitingBedClear && found.is_on(self.name()) {
            return self.clear_bed(job).await;
        }
        Ok(())
    }

    /// Runs the program that clears the bed, where there is one, and believes what it says.
    pub(super) async fn clear_bed(&mut self, job: JobId) -> Result<(), store::Error> {
        let Some(hook) = self.config.bed_clear.clone() else { return Ok(()) };
        let mut stopping = self.kit.stopping.clone();
        let printer = self.name().to_string();
        // It may have to move the printer.
        self.port = None;
        let mut clearing = std::pin::pin!(clearing::run(&hook, &printer, job));
        let cleared = loop {
            tokio::select! {
                cleared = &mut clearing => break cleared,
                Some(wished) = self.wishes.recv() => {
                    // Whoever asked may have left.
                    wished.answer.send(Err(not_now("its bed is being cleared"))).ok();
                }
                () = ended(&mut stopping) => break Err("the server ends".to_owned()),
            }
        };
        if let Err(why) = cleared {
            tracing::warn!(printer, %job, why, "bed: not cleared");
            self.tell("bed-not-cleared", Some(job), &why);
            return Ok(());
        }
        match self.say(Said::BedClearOf(job, Evidence::Hook), "the program says so").await {
            Err(store::Error::Gone) => Err(store::Error::Gone),
            Err(error) => {
                tracing::warn!(printer, %job, "bed: {error}");
                Ok(())
            }
            Ok(()) => Ok(()),
        }
    }
}
