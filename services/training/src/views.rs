//! The views that a run draws from, in memory as they are on disk, by split.
//!
//! A view is unpacked when it is drawn (about a millisecond): the paper's 127,000 views take 3 GB packed and 25 GB unpacked.

use std::{
    collections::{BTreeMap, BTreeSet},
    io::ErrorKind,
    path::{Path, PathBuf},
};

use repose_dataset::{ReadError, ReleaseRecord, Shard, Split, ViewRecord, read_releases, shard_paths};

/// Objects with fewer clean pixels than this in a view are neither queries nor anchors.
pub const PIXELS_LEAST: usize = 60;

/// Trials of one episode, at most: more would share one scene too often.
pub const TRIALS_AT_ONCE: usize = 4;

/// An object of a view that can be a query.
#[derive(Debug, Clone, Copy)]
struct Query {
    shard: u32,
    view: u32,
    object: u16,
}

/// A view with one of its objects taken as the query.
#[derive(Debug)]
pub struct QueryView<'a> {
    /// The view.
    pub view: ViewRecord,
    /// The query, by its position among the view's objects.
    pub query: usize,
    /// The outcomes of the query's releases; empty unless the views were opened with [`Views::released`].
    pub releases: &'a [ReleaseRecord],
}

/// All views of one split, in shard order.
#[derive(Debug)]
pub struct Views {
    folder: PathBuf,
    split: Split,
    seen: BTreeSet<PathBuf>,
    shards: Vec<Shard>,
    views: usize,
    /// Every object that is visible enough, in views with at least two such. With outcomes, an object is listed as often as it takes to see all of
    /// its outcomes, [`TRIALS_AT_ONCE`] at a time.
    queries: Vec<Query>,
    /// Outcomes of releases by scene and object, with [`Views::released`]; then only objects that have some are queries.
    releases: Option<BTreeMap<(u64, u16), Vec<ReleaseRecord>>>,
}

impl Views {
    /// Reads the shards in the split's own folder (`train`, `validation`, `test`) below `folder`, or in `folder` itself.
    ///
    /// # Errors
    /// When the folder cannot be listed or a shard cannot be read.
    pub fn open(folder: &Path, split: Split) -> Result<Self, ReadError> {
        Self::with_releases(folder, split, false)
    }

    /// The same, with the outcomes of releases; only objects that have some are queries.
    ///
    /// # Errors
    /// As [`Views::open`].
    pub fn released(folder: &Path, split: Split) -> Result<Self, ReadError> {
        Self::with_releases(folder, split, true)
    }

    fn with_releases(folder: &Path, split: Split, released: bool) -> Result<Self, ReadError> {
        let own = folder.join(split.name());
        let folder = if own.is_dir() { own } else { folder.to_path_buf() };
        let mut views = Self {
            folder,
            split,
            seen: BTreeSet::new(),
            shards: Vec::new(),
            views: 0,
            queries: Vec::new(),
            releases: released.then(BTreeMap::new),
        };
        views.rescan()?;
        Ok(views)
    }

    /// The outcomes of an object's releases; empty without outcomes.
    fn releases_of(&self, scene_seed: u64, object: u16) -> &[ReleaseRecord] {
        self.releases.as_ref().and_then(|all| all.get(&(scene_seed, object))).map_or(&[], Vec::as_slice)
    }

    /// Reads new shards, and with outcomes all of them again. Returns how many views were added.
    ///
    /// # Errors
    /// As [`Views::open`].
    pub fn rescan(&mut self) -> Result<usize, ReadError> {
        let before = self.views;
        for path in shard_paths(&self.folder)? {
            if self.seen.contains(&path) {
                continue;
            }
            let shard = match Shard::open(&path) {
                // It was there a moment ago: a longer run of the generator is replacing it.
                Err(ReadError::Io { source, .. }) if source.kind() == ErrorKind::NotFound => continue,
                opened => opened?,
            };
            self.seen.insert(path);
            // Shards of other splits may lie in the same folder.
            if shard.summaries().any(|view| Split::of_seed(view.scene_seed) == Some(self.split)) {
                self.shards.push(shard);
            }
        }
        if let Some(releases) = &mut self.releases {
            releases.clear();
            for record in read_releases(&self.folder)? {
                releases.entry((record.scene_seed, record.object)).or_default().push(record);
            }
        }
        self.find_queries();
        Ok(self.views.saturating_sub(before))
    }

    /// Finds the queries of all shards again: with new outcomes, more objects are queries.
    fn find_queries(&mut self) {
        let (mut views, mut queries) = (0, Vec::new());
        // A short shard that a longer run of the generator has replaced since holds the first scenes of the one in its place.
        let mut found = BTreeSet::new();
        for (index, shard) in (0..).zip(&self.shards) {
            let own = shard.summaries().enumerate().filter(|(_, view)| Split::of_seed(view.scene_seed) == Some(self.split));
            for (v, view) in own.filter(|(_, view)| found.insert((view.scene_seed, view.view))) {
                let large = view.alone_px().enumerate().filter(|(_, px)| *px as usize >= PIXELS_LEAST);
                let usable: Vec<Query> = large.map(|(k, _)| Query { shard: index, view: v as u32, object: k as u16 }).collect();
                if usable.len() >= 2 {
                    let ids: Vec<u16> = view.ids().collect();
                    let entries = |q: &Query| match &self.releases {
                        Some(_) => self.releases_of(view.scene_seed, ids[usize::from(q.object)]).len().div_ceil(TRIALS_AT_ONCE),
                        None => 1,
                    };
                    let before = queries.len();
                    queries.extend(usable.into_iter().flat_map(|q| std::iter::repeat_n(q, entries(&q))));
                    views += usize::from(queries.len() > before);
                }
            }
        }
        (self.views, self.queries) = (views, queries);
    }

    /// How many views there are.
    pub fn len(&self) -> usize {
        self.views
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.views == 0
    }

    /// How many (view, query) pairs there are.
    pub fn queries(&self) -> usize {
        self.queries.len()
    }

    /// The `i`-th (view, query) pair; `None`, with a warning, if the view's pixels are broken.
    pub fn query(&self, i: usize) -> Option<QueryView<'_>> {
        let Query { shard, view, object } = self.queries[i];
        match self.shards[shard as usize].view(view as usize) {
            Ok(view) => {
                let query = usize::from(object);
                Some(QueryView { releases: self.releases_of(view.scene_seed, view.objects[query].id), view, query })
            }
            Err(error) => {
                tracing::warn!(%error, "a broken view is skipped");
                None
            }
        }
    }
}
