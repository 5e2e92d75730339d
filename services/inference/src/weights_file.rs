//! Weights that change while they are served: the file is checked at intervals, and new weights are loaded and tried before they replace the
//! old. A file that cannot be read or does not fit is reported once, and the old weights stay in service. One that cannot be read is tried again
//! at every check: another owner or mode, or fewer open files in this process, make it readable and leave its time and length as they were.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use tokio_util::task::AbortOnDropHandle;

use crate::config::InferenceConfig;
use crate::worker::Worker;
use crate::{InferenceError, loaded};

/// What distinguishes versions of a file: when it was written, its length, and which file it is; `None` without a file.
///
/// All weights of one recipe are as long, and images that are built reproducibly give every file the same time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Version(Option<(SystemTime, u64, u64)>);

impl Version {
    /// The current version of the configured file.
    pub fn of(config: &InferenceConfig) -> Self {
        Self(config.weights.as_deref().and_then(|path| {
            let metadata = std::fs::metadata(path).ok()?;
            Some((metadata.modified().ok()?, metadata.len(), file_number(&metadata)))
        }))
    }
}

/// The number that the file system gives a file: another one where it was replaced.
#[cfg(unix)]
fn file_number(metadata: &std::fs::Metadata) -> u64 {
    std::os::unix::fs::MetadataExt::ino(metadata)
}

/// Elsewhere files have none that can be asked for.
#[cfg(not(unix))]
fn file_number(_: &std::fs::Metadata) -> u64 {
    0
}

/// Watches the configured file for a worker until the handle is dropped; `None` without a configured file or interval. `served` is the version
/// that the worker's weights were read from, taken before they were read.
pub fn watch(worker: &Arc<Worker>, config: &InferenceConfig, mut served: Version) -> Option<AbortOnDropHandle<()>> {
    let path = config.weights.clone().filter(|_| config.weights_check_ms > 0)?;
    let every = Duration::from_millis(config.weights_check_ms);
    let (worker, config) = (Arc::clone(worker), config.clone());
    let mut reported = served;
    Some(AbortOnDropHandle::new(tokio::spawn(async move {
        loop {
            tokio::time::sleep(every).await;
            let found = Version::of(&config);
            // A missing file is being replaced.
            if found == Version(None) || found == served {
                continue;
            }
            match swap(&worker, &path, config.clone()).await {
                Err(InferenceError::File { .. }) if found == reported => {}
                Err(error @ InferenceError::File { .. }) => tracing::error!(%error, "the new weights cannot be read"),
                Err(error) => {
                    tracing::error!(path = %path.display(), %error, "the new weights are not served");
                    served = found;
                }
                Ok(()) => served = found,
            }
            reported = found;
        }
    })))
}

/// Serves the file's weights from now on.
///
/// # Errors
/// When they cannot be read or served: those before stay in service.
async fn swap(worker: &Arc<Worker>, path: &Path, config: InferenceConfig) -> Result<(), InferenceError> {
    let engine = loaded(config).await?;
    tracing::info!(path = %path.display(), from = worker.engine().weights_hash(), to = engine.weights_hash(), "new weights");
    worker.serve_with(engine);
    Ok(())
}

#[cfg(test)]
mod tests {
    use repose_networks::{NetworksConfig, Weights};

    use super::*;
    use crate::engine_of;

    /// Renamed into place, as any file in use should be replaced.
    fn put(path: &Path, bytes: &[u8]) {
        let beside = path.with_extension("new");
        std::fs::write(&beside, bytes).unwrap();
        std::fs::rename(beside, path).unwrap();
    }

    async fn comes_to_be(worker: &Worker, hash: &str) -> bool {
        for _ in 0..1000 {
            if worker.engine().weights_hash() == hash {
                return true;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        false
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_new_file_is_served_and_a_broken_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.safetensors");
        let weights = [1, 2].map(|seed| Weights::initial(&NetworksConfig::paper(), seed).unwrap());
        let hashes = weights.each_ref().map(|bytes| Weights::from_bytes(bytes).unwrap().hash);
        put(&path, &weights[0]);
        let config = InferenceConfig { weights: Some(path.clone()), threads: 1, weights_check_ms: 10, ..InferenceConfig::default() };
        let worker = Arc::new(Worker::start(engine_of(&config).unwrap(), &config, Arc::default()).unwrap());
        let _watch = watch(&worker, &config, Version::of(&config)).unwrap();
        assert_eq!(worker.engine().weights_hash(), hashes[0]);
        put(&path, b"no weights");
        tokio::time::sleep(Duration::from_millis(300)).await;
        assert_eq!(worker.engine().weights_hash(), hashes[0]);
        put(&path, &weights[1]);
        assert!(comes_to_be(&worker, &hashes[1]).await);
    }

    #[cfg(unix)]
    #[tokio::test(flavor = "multi_thread")]
    async fn a_file_that_could_not_be_read_is_served_once_it_can_be() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.safetensors");
        let weights = [1, 2].map(|seed| Weights::initial(&NetworksConfig::paper(), seed).unwrap());
        put(&path, &weights[0]);
        let config = InferenceConfig { weights: Some(path.clone()), threads: 1, weights_check_ms: 10, ..InferenceConfig::default() };
        let worker = Arc::new(Worker::start(engine_of(&config).unwrap(), &config, Arc::default()).unwrap());
        let _watch = watch(&worker, &config, Version::of(&config)).unwrap();
        let beside = path.with_extension("new");
        std::fs::write(&beside, &weights[1]).unwrap();
        let mode = |path: &Path, mode: u32| std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
        mode(&beside, 0o000);
        std::fs::rename(&beside, &path).unwrap();
        if std::fs::read(&path).is_ok() {
            // Nothing is kept from root.
            return;
        }
        tokio::time::sleep(Duration::from_millis(300)).await;
        mode(&path, 0o600);
        assert!(comes_to_be(&worker, &Weights::from_bytes(&weights[1]).unwrap().hash).await);
    }

    #[cfg(unix)]
    #[test]
    fn a_file_in_anothers_place_is_another_version_though_it_is_as_long_and_as_old() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.safetensors");
        let config = InferenceConfig { weights: Some(path.clone()), ..InferenceConfig::default() };
        let version = |bytes: &[u8]| {
            put(&path, bytes);
            std::fs::File::options().write(true).open(&path).unwrap().set_modified(SystemTime::UNIX_EPOCH).unwrap();
            Version::of(&config)
        };
        let (first, second) = (version(b"one"), version(b"two"));
        assert_ne!(first, second);
        assert_eq!(Version::of(&config), second, "it stays the same as long as it is let be");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_file_that_is_replaced_while_the_first_is_loaded_is_served() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.safetensors");
        let weights = [1, 2].map(|seed| Weights::initial(&NetworksConfig::paper(), seed).unwrap());
        put(&path, &weights[0]);
        let config = InferenceConfig { weights: Some(path.clone()), threads: 1, weights_check_ms: 10, ..InferenceConfig::default() };
        let version = Version::of(&config);
        let worker = Arc::new(Worker::start(engine_of(&config).unwrap(), &config, Arc::default()).unwrap());
        put(&path, &weights[1]);
        let _watch = watch(&worker, &config, version).unwrap();
        assert!(comes_to_be(&worker, &Weights::from_bytes(&weights[1]).unwrap().hash).await);
    }
}
