//! The views that a run draws from, in memory, by split.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use repose_dataset::{ReadError, Split, ViewRecord, read_shard, shard_paths};

/// Objects with fewer clean pixels than this in a view are neither queries nor anchors.
pub const PIXELS_LEAST: usize = 60;

/// All views of one split, in shard order.
#[derive(Debug)]
pub struct Views {
    folder: PathBuf,
    split: Split,
    seen: BTreeSet<PathBuf>,
    views: Vec<ViewRecord>,
    /// (view, object) of every object that is visible enough, in views with at least two such.
    queries: Vec<(u32, u16)>,
}

impl Views {
    /// Reads what is there: shards in the split's own folder (`train`, `validation`, `test`) below `folder`, or in `folder` itself.
    ///
    /// # Errors
    /// When the folder cannot be listed or a shard cannot be read.
    pub fn open(folder: &Path, split: Split) -> Result<Self, ReadError> {
        let own = folder.join(split.name());
        let folder = if own.is_dir() { own } else { folder.to_path_buf() };
        let mut views = Self { folder, split, seen: BTreeSet::new(), views: Vec::new(), queries: Vec::new() };
        views.rescan()?;
        Ok(views)
    }

    /// Reads shards that were not there before; says how many views were added.
    ///
    /// # Errors
    /// As [`Views::open`].
    pub fn rescan(&mut self) -> Result<usize, ReadError> {
        let before = self.views.len();
        for path in shard_paths(&self.folder)? {
            if self.seen.insert(path.clone()) {
                for view in read_shard(&path)? {
                    if Split::of_seed(view.scene_seed) == Some(self.split) {
                        self.add(view);
                    }
                }
            }
        }
        Ok(self.views.len() - before)
    }

    fn add(&mut self, view: ViewRecord) {
        let usable: Vec<u16> =
            (0..view.objects.len() as u16).filter(|k| view.objects[usize::from(*k)].alone.count() >= PIXELS_LEAST).collect();
        if usable.len() >= 2 {
            let index = self.views.len() as u32;
            self.queries.extend(usable.iter().map(|k| (index, *k)));
            self.views.push(view);
        }
    }

    /// How many views there are.
    pub fn len(&self) -> usize {
        self.views.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.views.is_empty()
    }

    /// How many (view, query) pairs there are.
    pub fn queries(&self) -> usize {
        self.queries.len()
    }

    /// The `i`-th (view, query) pair.
    pub fn query(&self, i: usize) -> (&ViewRecord, usize) {
        let (view, query) = self.queries[i];
        (&self.views[view as usize], usize::from(query))
    }
}
