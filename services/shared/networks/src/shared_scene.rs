//! The outcome network's inputs (ours): one sampling per scene, whose features all candidates share.
//!
//! With a crop and a sampling per candidate, as in the paper, no computation serves two candidates. Here the scene without the query has its
//! own points and centroids, whose neighbours are never the query's, so that their features are computed once. The query has its own
//! centroids, whose neighbours are its points and the scene's: information about a place flows from the scene to the query. Half of the
//! query's first centroids are its points projected down to its lowest height, since an object is supported there and not on the sides that
//! a camera sees. Only coordinates relative to a centroid count, so features do not depend on the scene's place in the world.

use crate::{
    ball_query::ball_query,
    config::NetworksConfig,
    crops::{Grouped, Grouping},
    kernel::{Kernel, PointColumns},
    neighbours::Neighbours,
    points::{ObjectCloud, SceneCloud},
};

/// The scene's part: points in sampling order, and what its centroids look at.
#[derive(Debug, Clone)]
pub struct SharedScene {
    /// `[points, 3]`, metres; the first are the centroids of both levels.
    pub points: Vec<[f32; 3]>,
    /// What the centroids of the first level look at: points.
    pub first: Neighbours,
    /// What those of the second look at: centroids of the first.
    pub second: Neighbours,
    /// How many things there are to look at, at each level: points, centroids, centroids of the second level.
    pub counts: [usize; 3],
    columns: [PointColumns; 2],
}

/// The query's part of one candidate. Indices below the scene's count mean the scene's points, those from there on the query's.
#[derive(Debug, Clone)]
pub struct PlacedQuery {
    /// `[points, 3]`, where the candidate puts them.
    pub points: Vec<[f32; 3]>,
    /// `[centroids, 3]`; each level has the first of them.
    pub centroids: Vec<[f32; 3]>,
    /// What the centroids of each level look at.
    pub lists: [Neighbours; 3],
    /// Where the candidate puts the centroid of the observed cloud.
    pub position: [f32; 3],
}

impl SharedScene {
    /// From the scene without the query. A scene without points is one point far below.
    pub fn new(kernel: Kernel, config: &NetworksConfig, scene_without_query: &SceneCloud) -> Self {
        let mut points = scene_without_query.points.clone();
        if points.is_empty() {
            points.push([0.0, 0.0, -10.0]);
        }
        let levels = &config.discriminator_levels;
        let counts = [points.len(), config.shared.scene_centroids[0].min(points.len()), 0];
        let counts = [counts[0], counts[1], config.shared.scene_centroids[1].min(counts[1])];
        let within = |from: &[[f32; 3]], centroids: usize, level: usize| {
            ball_query(kernel, from, centroids, levels[level].neighbours, levels[level].radius_m)
        };
        let first = within(&points, counts[1], 0);
        let second = within(&points[..counts[1]], counts[2], 1);
        let columns = [PointColumns::new(&points[..counts[1]]), PointColumns::new(&points[..counts[2]])];
        Self { points, first, second, counts, columns }
    }

    /// A candidate's part: the query (already turned) with its centroid at `position`.
    pub fn placed(&self, kernel: Kernel, config: &NetworksConfig, query: &ObjectCloud, position: [f32; 3]) -> PlacedQuery {
        let points: Vec<[f32; 3]> = query.points.iter().map(|p| std::array::from_fn(|k| p[k] + position[k])).collect();
        let lowest_m = points.iter().map(|p| p[2]).fold(f32::INFINITY, f32::min);
        // A point and the same let down, in turn, so that the first of them are half and half at every level.
        let sources = (config.shared.query_centroids[0] / 2).min(points.len());
        let centroids: Vec<[f32; 3]> = points[..sources].iter().flat_map(|p| [*p, [p[0], p[1], lowest_m]]).collect();
        let [own_most, scene_most] = config.shared.neighbours;
        let near = self.near(&points, config.discriminator_levels[0].radius_m);
        let near_points: Vec<[f32; 3]> = near.iter().map(|i| self.points[*i as usize]).collect();
        let near_columns = PointColumns::new(&near_points);
        let [second, third] = [1, 2].map(|level| config.shared.query_centroids[level].min(centroids.len()));
        let own_columns = [&points[..], &centroids, &centroids[..second]].map(PointColumns::new);
        let counts = [centroids.len(), second, third];
        let mut found = Vec::new();
        let lists = std::array::from_fn(|level| {
            let radius_m = config.discriminator_levels[level].radius_m;
            let mut lists = Neighbours::new();
            for (c, center) in centroids[..counts[level]].iter().enumerate() {
                let mut list: Vec<u32> = Vec::with_capacity(own_most + scene_most + 1);
                let count = self.counts[level] as u32;
                if level == 0 {
                    // Its own point is always there, or one let down into the open would look at nothing.
                    list.push(count + (c / 2) as u32);
                }
                found.clear();
                kernel.within(&own_columns[level], *center, radius_m, own_most, &mut found);
                list.extend(found.iter().filter(|i| level > 0 || **i as usize != c / 2).map(|i| count + i));
                found.clear();
                if level == 0 {
                    kernel.within(&near_columns, *center, radius_m, scene_most, &mut found);
                    list.extend(found.iter().map(|i| near[*i as usize]));
                } else {
                    kernel.within(&self.columns[level - 1], *center, radius_m, scene_most, &mut found);
                    list.extend_from_slice(&found);
                }
                lists.push(&list);
            }
            lists
        });
        PlacedQuery { points, centroids, lists, position }
    }

    /// The scene's points that may be within `reach_m` of one of some points.
    fn near(&self, points: &[[f32; 3]], reach_m: f32) -> Vec<u32> {
        let low: [f32; 3] = std::array::from_fn(|k| points.iter().map(|p| p[k]).fold(f32::INFINITY, f32::min) - reach_m);
        let high: [f32; 3] = std::array::from_fn(|k| points.iter().map(|p| p[k]).fold(f32::NEG_INFINITY, f32::max) + reach_m);
        let is_near = |p: &[f32; 3]| (0..3).all(|k| p[k] >= low[k] && p[k] <= high[k]);
        self.points.iter().enumerate().filter(|(_, p)| is_near(p)).map(|(i, _)| i as u32).collect()
    }

    /// Scene and candidates as one sample of as many outputs as there are candidates, for training and for tests: nothing is shared but what
    /// the lists say.
    pub fn grouped(&self, candidates: &[PlacedQuery]) -> Grouped {
        let [n0, n1, n2] = self.counts;
        let mut points = self.points.clone();
        let mut levels: Vec<Grouping> = vec![
            Grouping { centroids: self.points[..n1].to_vec(), neighbours: self.first.clone() },
            Grouping { centroids: self.points[..n2].to_vec(), neighbours: self.second.clone() },
            Grouping { centroids: Vec::new(), neighbours: Neighbours::new() },
            Grouping { centroids: Vec::new(), neighbours: Neighbours::new() },
        ];
        for candidate in candidates {
            // Where the candidate's own things begin among what each level looks at.
            let begins = [points.len(), levels[0].centroids.len(), levels[1].centroids.len()];
            let first_of_last = levels[2].centroids.len();
            for (level, (list, begin)) in candidate.lists.iter().zip(begins).enumerate() {
                let count = [n0, n1, n2][level];
                for c in 0..list.centroids() {
                    let moved = |i: &u32| if (*i as usize) < count { *i } else { *i - count as u32 + begin as u32 };
                    levels[level].neighbours.push(&list.of(c).iter().map(moved).collect::<Vec<_>>());
                }
                levels[level].centroids.extend_from_slice(&candidate.centroids[..list.centroids()]);
            }
            points.extend_from_slice(&candidate.points);
            let all: Vec<u32> = (first_of_last as u32..levels[2].centroids.len() as u32).collect();
            levels[3].neighbours.push(&all);
            levels[3].centroids.push(candidate.position);
        }
        let mut is_query = vec![0.0; n0];
        is_query.resize(points.len(), 1.0);
        Grouped { points, is_query, levels }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::points::CloudConfig;

    fn table_and_block() -> (SceneCloud, ObjectCloud) {
        let points: Vec<[f32; 3]> = (0..3600).map(|i| [(i % 60) as f32 * 0.01 - 0.3, (i / 60) as f32 * 0.01 - 0.3, 0.0]).collect();
        let block: Vec<_> = (0..400).map(|i| Point3::new((i % 20) as f32 * 0.003, 0.0, (i / 20) as f32 * 0.005)).collect();
        let config = CloudConfig { voxel_m: 0.001, ..CloudConfig::default() };
        (
            SceneCloud { labels: vec![0; points.len()], points },
            ObjectCloud::new(&block, &crate::points::tests::observer(), &config).unwrap(),
        )
    }

    #[test]
    fn lists_point_at_what_is_near_and_no_centroid_is_alone() {
        let (scene, query) = table_and_block();
        let config = NetworksConfig::default();
        let kernel = Kernel::detect();
        let shared = SharedScene::new(kernel, &config, &scene);
        for height_m in [0.05, 2.0] {
            let placed = shared.placed(kernel, &config, &query, [0.02, 0.03, height_m]);
            let wholes = [&placed.points[..], &placed.centroids, &placed.centroids];
            for (level, lists) in placed.lists.iter().enumerate() {
                assert_eq!(lists.centroids(), config.shared.query_centroids[level]);
                for c in 0..lists.centroids() {
                    let list = lists.of(c);
                    assert!(!list.is_empty());
                    for (k, i) in list.iter().enumerate() {
                        let at = match (*i as usize).checked_sub(shared.counts[level]) {
                            Some(own) => wholes[level][own],
                            None => shared.points[*i as usize],
                        };
                        let apart = (0..3).map(|k| (at[k] - placed.centroids[c][k]).powi(2)).sum::<f32>().sqrt();
                        let is_source = level == 0 && k == 0;
                        assert!(is_source || apart <= config.discriminator_levels[level].radius_m * 1.0001, "level {level}: {apart}");
                    }
                }
            }
            let sees_the_table = placed.lists[0].indices().iter().any(|i| (*i as usize) < shared.counts[0]);
            assert_eq!(sees_the_table, height_m < 0.1);
        }
    }

    #[test]
    fn candidates_do_not_look_at_each_other() {
        let (scene, query) = table_and_block();
        let config = NetworksConfig::default();
        let kernel = Kernel::detect();
        let shared = SharedScene::new(kernel, &config, &scene);
        let placed: Vec<PlacedQuery> =
            [[0.02, 0.03, 0.05], [0.03, 0.03, 0.05]].map(|at| shared.placed(kernel, &config, &query, at)).to_vec();
        let all = shared.grouped(&placed);
        let n = shared.counts[0] + query.points.len();
        let first = shared.counts[1]..shared.counts[1] + placed[0].centroids.len();
        assert!(first.clone().all(|c| all.levels[0].neighbours.of(c).iter().all(|i| (*i as usize) < n)));
        assert_eq!(all.levels[3].centroids, [[0.02, 0.03, 0.05], [0.03, 0.03, 0.05]]);
        assert_eq!(all.levels[3].neighbours.of(1)[0], 32);
    }
}
