//! What a world on a GPU does about losing it: a good state is copied to the host now and then, and the world goes on from there.

use std::sync::Arc;
use std::time::Instant;

use welkin_proto::ApiError;
use welkin_shaders::catalogue::Field;

use super::{HOST_COPY_EVERY, HostCopy, World};
use crate::watchdog::{Trouble, Watchdog};

impl World {
    /// Copies the state to the host where the device may be lost, when the last copy has become old.
    pub(super) fn keep_host_copy(&mut self) {
        if self.host_copy_is_fresh() {
            return;
        }
        let held = Field::STATE.into_iter().filter(|f| self.plan.fields.contains(f));
        // A device that is lost meanwhile answers nothing; the copy before stays.
        let fields: Option<Vec<_>> = held.map(|f| Some((f, self.device.read(f)?.into_owned()))).collect();
        if let Some(fields) = fields {
            self.host_copy = Some(HostCopy {
                fields,
                mark: self.mark(),
                made: Instant::now(),
            });
        }
    }

    /// Whether no copy on the host is due: the last one is young, or the device cannot be lost.
    pub(super) fn host_copy_is_fresh(&self) -> bool {
        let fresh = |copy: &HostCopy| copy.made.elapsed() < HOST_COPY_EVERY;
        !self.device.lags() || self.host_copy.as_ref().is_some_and(fresh)
    }

    /// Opens the device again and goes on from the host's copy of the state. Errors: the adapter is gone, or refuses what it gave before.
    pub(super) fn rebuild(&mut self, failed_s: f64, lost: &Trouble) -> Result<(), ApiError> {
        let copy = self.host_copy.take();
        let copy = copy.ok_or_else(|| ApiError::new("device_lost", "the host holds no state"))?;
        self.machine.compute.reopen()?;
        self.parameters = Arc::clone(&copy.mark.parameters);
        let mut device = self.machine.compute.device(&self.parameters, &self.plan)?;
        for (field, values) in &copy.fields {
            device.write(*field, values);
        }
        self.device = device;
        self.recall(&copy.mark);
        self.publish();
        Watchdog::slots().for_each(|slot| self.device.save(slot));
        self.watchdog.rebuilt(self.tick, failed_s, lost.clone(), &copy.mark);
        self.host_copy = Some(copy);
        Ok(())
    }

    /// A device that is gone for good, as trouble.
    pub(super) fn device_lost(&self) -> Option<Trouble> {
        let error = self.device.trouble()?;
        Some(Trouble {
            code: "device_lost",
            message: format!("the device is lost: {error}"),
        })
    }
}
