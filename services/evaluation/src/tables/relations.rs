//! The paper's Table 2 and its appendix: how well each relation is told, learned against by rule, on scenes never trained on.
//!
//! An example is an ordered pair (query, anchor) of objects of one view: both are seen in it (as the data set counts it), and perception
//! kept points of both. Ground truth: instance masks, the camera's pose (and so gravity), meshes and poses; the label is the relation by
//! rule on those. Observed: depth with a random camera's faults, flying readings and borders cleaned by perception itself, so that the
//! table says what users get; or, to compare with the paper, depth as it was rendered ([`CloudSource`]). Both methods see the same clouds with the
//! query where it is. Intervals draw whole scenes.

use repose_dataset::{Split, ViewRecord};
use repose_geometry::{Point3, ViewerFrame};
use repose_inference::{Engine, HeldScene};
use repose_networks::config::PREDICTED_RELATIONS;
use repose_networks::serving::spread;
use repose_proto::scoring::{RealismBy, ScoreRequest};
use repose_proto::{CallError, RELATION_COUNT, Relation, Scene, SceneRef};
use repose_relations::{Confusion, ObservedObject, observed};
use repose_sensor::SensorModel;
use repose_simulator::generate::view_rng;
use repose_simulator::render::DepthCanvas;
use repose_simulator::scene::{SceneSettings, scene_of_seed};
use repose_simulator::viewpoint::ViewpointSettings;
use repose_simulator::views::view_of_scene;
use serde::Serialize;

use crate::scenes::problem::frame_with;
use crate::statistics::resample::interval;
use crate::tables::paper::{self, PaperRelation};

/// A relation is said to hold from this probability on.
const HOLDS_FROM: f32 = 0.5;
/// Scenes looked at between two looks at how many examples there are; the table does not depend on it.
const SCENES_AT_ONCE: usize = 16;
/// Scenes without an example in a row after which the search for more ends.
const MOST_EMPTY: usize = 400;

/// The pictures that an example's clouds are taken from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CloudSource {
    /// As in the paper's data set: the query from a picture without any other object, the anchors from the picture without the query, depth
    /// and masks as they were rendered. (The paper drops the borders of masks on its real robot only, and has no noise.)
    Rendered,
    /// The same pictures as a random camera takes them, with the borders of masks dropped. So does a planner see objects that tries a place
    /// for one which stands elsewhere.
    Apart,
    /// Both from the picture with all objects, each hiding what it hides: so are objects seen that are described where they stand.
    Together,
}

/// Where examples come from.
#[derive(Debug, Clone)]
pub struct RelationsSettings {
    /// Which picture the clouds are from.
    pub shown: CloudSource,
    /// How scenes are made; the mixture of the training data by default.
    pub scene: SceneSettings,
    /// How cameras are chosen; the picture's size too.
    pub viewpoint: ViewpointSettings,
    /// How frames are segmented (true masks are given).
    pub perception: repose_perception::Settings,
    /// The first scene, counted from the split's first seed.
    pub first: u64,
    /// Views of a scene. More of them say less than as many scenes do.
    pub views: u32,
    /// Threads to work with; the table does not depend on it.
    pub threads: usize,
}

impl Default for RelationsSettings {
    fn default() -> Self {
        Self {
            shown: CloudSource::Rendered,
            scene: SceneSettings::default(),
            viewpoint: ViewpointSettings { width: 640, height: 480, ..ViewpointSettings::default() },
            perception: repose_perception::Settings::default(),
            first: 0,
            views: 1,
            threads: 2,
        }
    }
}

/// How a relation is judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum JudgedBy {
    /// By the relation predictor.
    Network,
    /// By rule on the observed clouds: the networks leave `aligned` out, as the paper's do.
    Rule,
}

/// A figure with its 95 % interval, 0 to 1; `None` where it is not defined.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Figure {
    /// The figure.
    pub value: Option<f64>,
    /// Its interval over scenes.
    pub interval: Option<[f64; 2]>,
}

/// What is said of one method on one relation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct MethodScores {
    /// The counts.
    pub counts: Confusion,
    /// Harmonic mean of precision and sensitivity.
    pub f1: Figure,
    /// The F1 of this sensitivity and specificity at the paper's prevalence.
    pub f1_at_paper_prevalence: Figure,
    /// Share of what holds that was found.
    pub sensitivity: Figure,
    /// Share of what does not hold that was not claimed.
    pub specificity: Figure,
}

/// One relation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RelationRow {
    /// Which.
    pub relation: Relation,
    /// How `learned` was judged.
    pub judged_by: JudgedBy,
    /// What the system answers.
    pub learned: MethodScores,
    /// The paper's model-based baseline: rules on the observed clouds.
    pub baseline: MethodScores,
    /// The paper's figures.
    pub paper: Option<PaperRelation>,
}

/// The table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RelationsTable {
    /// Examples: ordered pairs.
    pub examples: usize,
    /// Scenes that they come from.
    pub scenes: usize,
    /// Views that they come from.
    pub views: usize,
    /// Ordered pairs that the views show, but of which perception kept no points of one.
    pub lost: usize,
    /// One row a relation, in wire order.
    pub rows: Vec<RelationRow>,
}

/// The counts of one scene.
#[derive(Debug, Clone, Copy, Default)]
struct SceneCounts {
    examples: usize,
    lost: usize,
    views: usize,
    learned: [Confusion; RELATION_COUNT],
    baseline: [Confusion; RELATION_COUNT],
}

/// Judges pairs of a split's scenes, in the order of their seeds, until there are `examples`; the last scene is judged whole. `seen` is told
/// how many there are.
///
/// The engine is asked from several threads at once, so it should have one of its own.
///
/// # Errors
/// What the engine answers on a scene that it should have been able to take.
pub fn evaluate_relations(
    split: Split,
    examples: usize,
    engine: &Engine,
    settings: &RelationsSettings,
    mut seen: impl FnMut(usize),
) -> Result<RelationsTable, CallError> {
    let mut scenes: Vec<SceneCounts> = Vec::new();
    let (mut found, mut empty) = (0, 0);
    let mut seeds = split.seeds();
    seeds.start += settings.first;
    while found < examples && empty < MOST_EMPTY {
        let batch: Vec<u64> = seeds.by_ref().take(SCENES_AT_ONCE).collect();
        if batch.is_empty() {
            break;
        }
        let canvas = || DepthCanvas::new(settings.viewpoint.width, settings.viewpoint.height);
        let counted = spread(batch.len(), settings.threads, canvas, |canvas, k| count_scene(batch[k], engine, settings, canvas));
        for counts in counted {
            let counts = counts?;
            if found >= examples {
                break;
            }
            empty = if counts.examples == 0 { empty + 1 } else { 0 };
            found += counts.examples;
            scenes.extend((counts.views > 0).then_some(counts));
        }
        seen(found);
    }
    Ok(table_of(&scenes))
}

/// The examples of a seed's scene.
fn count_scene(seed: u64, engine: &Engine, settings: &RelationsSettings, canvas: &mut DepthCanvas) -> Result<SceneCounts, CallError> {
    let mut counts = SceneCounts::default();
    let Ok((scene, _)) = scene_of_seed(seed, &settings.scene) else { return Ok(counts) };
    for view in 0..settings.views {
        let mut rng = view_rng(seed, view);
        let Some(record) = view_of_scene(&scene, view, &settings.viewpoint, false, canvas, &mut rng) else { continue };
        // A camera as training draws them: the named ones would lose what a wrist holds them close to.
        let sensor = SensorModel::jittered(&mut rng);
        let noise_seed = seed.wrapping_mul(u64::from(settings.views)).wrapping_add(u64::from(view));
        let mut perception = settings.perception.clone();
        let sensor = match settings.shown {
            CloudSource::Rendered => {
                perception.borders.radius_px = 0;
                SensorModel::ideal()
            }
            CloudSource::Apart | CloudSource::Together => sensor,
        };
        let picture = |present: &dyn Fn(u16) -> bool| {
            let frame = frame_with(&scene, present, &record.camera, &record.world_from_camera, &sensor, noise_seed);
            repose_perception::segment(&frame, &perception).ok()
        };
        count_view(&record, &picture, perception.borders.radius_px, settings.shown, engine, &mut counts)?;
    }
    Ok(counts)
}

/// What perception makes of a view of those objects of whose id something holds.
type Picture<'a> = dyn Fn(&dyn Fn(u16) -> bool) -> Option<Scene> + 'a;

/// Counts a view's examples.
fn count_view(
    record: &ViewRecord,
    picture: &Picture<'_>,
    border_px: usize,
    shown: CloudSource,
    engine: &Engine,
    counts: &mut SceneCounts,
) -> Result<(), CallError> {
    let held = |scene: Scene| HeldScene::new(scene.id(), std::sync::Arc::new(scene)).cleaned_by(border_px as f32);
    let Some(together) = picture(&|_| true) else { return Ok(()) };
    counts.views += 1;
    let objects: Vec<usize> = (0..record.objects.len()).filter(|k| record.is_seen(*k)).collect();
    if shown == CloudSource::Together {
        return count_queries(record, &objects, &objects, &held(together), engine, counts);
    }
    for query in &objects {
        let id = record.objects[*query].id;
        let scene = picture(&|other| other != id).zip(picture(&|other| other == id));
        match scene.and_then(|(without, alone)| with_query(without, &alone, id)) {
            Some(scene) => count_queries(record, &objects, &[*query], &held(scene), engine, counts)?,
            None => counts.lost += objects.len() - 1,
        }
    }
    Ok(())
}

/// A scene without the query, and the query as it was seen alone; `None` where nothing was seen of it.
fn with_query(mut scene: Scene, alone: &Scene, query: u16) -> Option<Scene> {
    scene.meta.objects.push(alone.object(query)?.clone());
    scene.meta.objects.sort_by_key(|o| o.id);
    scene.points.extend(alone.points_of(query));
    scene.labels.resize(scene.points.len(), query);
    scene.colors = None;
    Some(scene)
}

/// Counts the examples of some queries, with all objects `shown` as anchors.
fn count_queries(
    record: &ViewRecord,
    shown: &[usize],
    queries: &[usize],
    held: &HeldScene,
    engine: &Engine,
    counts: &mut SceneCounts,
) -> Result<(), CallError> {
    let scene = held.scene();
    let viewer = ViewerFrame::from_yaw(scene.meta.view_yaw_rad);
    let objects: Vec<(usize, u16, ObservedObject)> = shown
        .iter()
        .filter_map(|k| {
            let id = scene.object(record.objects[*k].id)?.id;
            let points: Vec<Point3<f32>> = scene.points_of(id).map(Point3::from).collect();
            Some((*k, id, ObservedObject::new(&points, &viewer)?))
        })
        .collect();
    let pairs = queries.len() * shown.len().saturating_sub(1);
    let before = counts.examples;
    for (query, query_id, query_cloud) in objects.iter().filter(|(k, ..)| queries.contains(k)) {
        let anchors: Vec<_> = objects.iter().filter(|(k, ..)| k != query).collect();
        let learned = learned_relations(engine, held, *query_id, &anchors.iter().map(|a| a.1).collect::<Vec<_>>())?;
        for ((anchor, _, anchor_cloud), learned) in anchors.into_iter().zip(learned) {
            let truth = record.relations_of(*query, *anchor);
            let by_rule = observed(query_cloud, anchor_cloud);
            counts.examples += 1;
            for r in 0..RELATION_COUNT {
                counts.learned[r].count(learned[r] >= HOLDS_FROM, truth[r]);
                counts.baseline[r].count(by_rule[r], truth[r]);
            }
        }
    }
    counts.lost += pairs - (counts.examples - before);
    Ok(())
}

/// What the system answers of a query where it stands, one row an anchor.
fn learned_relations(engine: &Engine, held: &HeldScene, query: u16, anchors: &[u16]) -> Result<Vec<[f32; RELATION_COUNT]>, CallError> {
    let object = held.scene().object(query).ok_or_else(|| CallError::not_found("query", format!("the scene has no object {query}")))?;
    let [x, y, z] = object.centroid_m.map(|c| c as f32);
    let request = ScoreRequest {
        scene: SceneRef { scene_id: held.scene_id().to_owned() },
        query,
        anchors: anchors.to_vec(),
        view_yaw_rad: held.scene().meta.view_yaw_rad,
        realism: false,
        realism_by: RealismBy::Discriminator,
        relations: true,
        candidates: vec![[x, y, z, 0.0]],
    };
    Ok(engine.score(&request, held)?.relations)
}

fn table_of(scenes: &[SceneCounts]) -> RelationsTable {
    let sum = |of: fn(&SceneCounts) -> usize| scenes.iter().map(of).sum();
    let rows = Relation::ALL.into_iter().map(|relation| {
        let r = relation.index();
        RelationRow {
            relation,
            judged_by: if r < PREDICTED_RELATIONS { JudgedBy::Network } else { JudgedBy::Rule },
            learned: scores(scenes, relation, |s| &s.learned[r]),
            baseline: scores(scenes, relation, |s| &s.baseline[r]),
            paper: paper::RELATIONS[r],
        }
    });
    RelationsTable {
        examples: sum(|s| s.examples),
        scenes: scenes.len(),
        views: sum(|s| s.views),
        lost: sum(|s| s.lost),
        rows: rows.collect(),
    }
}

fn scores(scenes: &[SceneCounts], relation: Relation, of: impl Fn(&SceneCounts) -> &Confusion) -> MethodScores {
    let counts: Vec<Confusion> = scenes.iter().map(|s| *of(s)).collect();
    let total = |drawn: &[&Confusion]| {
        drawn.iter().fold(Confusion::default(), |mut sum, c| {
            sum.merge(c);
            sum
        })
    };
    let whole = total(&counts.iter().collect::<Vec<_>>());
    let figure = |statistic: &dyn Fn(&Confusion) -> Option<f64>| Figure {
        value: statistic(&whole),
        interval: interval(&counts, relation.index() as u64, |drawn| statistic(&total(drawn))),
    };
    let prevalence = paper::RELATIONS[relation.index()].map(|p| p.true_percent / 100.0);
    MethodScores {
        counts: whole,
        f1: figure(&Confusion::f1),
        f1_at_paper_prevalence: prevalence.map_or_else(Figure::default, |p| figure(&|c| c.f1_at(p))),
        sensitivity: figure(&Confusion::sensitivity),
        specificity: figure(&Confusion::specificity),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use repose_networks::Models;

    #[test]
    fn objects_seen_apart_hide_nothing_of_each_other() {
        let settings = RelationsSettings::default();
        let mut canvas = DepthCanvas::new(settings.viewpoint.width, settings.viewpoint.height);
        let (mut pairs, mut uncovered) = (0, 0);
        for seed in Split::Validation.seeds().take(4) {
            let Ok((scene, _)) = scene_of_seed(seed, &settings.scene) else { continue };
            let Some(record) = view_of_scene(&scene, 0, &settings.viewpoint, false, &mut canvas, &mut view_rng(seed, 0)) else { continue };
            let picture = |present: &dyn Fn(u16) -> bool| {
                let ideal = SensorModel::named("ideal").expect("a sensor");
                let frame = frame_with(&scene, present, &record.camera, &record.world_from_camera, &ideal, 0);
                repose_perception::segment(&frame, &settings.perception).expect("a scene")
            };
            let together = picture(&|_| true);
            for query in together.meta.objects.iter().map(|o| o.id) {
                let apart =
                    with_query(picture(&|id| id != query), &picture(&|id| id == query), query).expect("seen together, so seen alone");
                assert_eq!(apart.points.len(), apart.labels.len());
                assert!(apart.meta.objects.is_sorted_by_key(|o| o.id));
                for id in together.meta.objects.iter().map(|o| o.id) {
                    // A neighbour's border takes some; a neighbour in front takes much.
                    let points = [&apart, &together].map(|scene| scene.points_of(id).count());
                    assert!(points[0] + 20 >= points[1], "object {id} without {query}: {points:?}");
                    pairs += 1;
                    uncovered += usize::from(points[0] as f64 > 1.1 * points[1] as f64);
                }
            }
        }
        assert!(pairs > 40 && uncovered > pairs / 10, "{uncovered} of {pairs}");
    }

    #[test]
    fn a_few_scenes_give_a_table_that_adds_up_on_any_number_of_threads() {
        let engine = Engine::new(Models::embedded().expect("embedded weights"), 1);
        let of = |threads: usize| {
            let settings = RelationsSettings { threads, ..RelationsSettings::default() };
            let mut told = 0;
            let table = evaluate_relations(Split::Validation, 30, &engine, &settings, |n| told = n).expect("a table");
            assert_eq!(told, table.examples);
            table
        };
        let table = of(2);
        assert!(table.examples >= 30 && table.scenes <= SCENES_AT_ONCE && table.views == table.scenes, "{table:?}");
        assert_eq!(table.rows.iter().map(|r| r.relation).collect::<Vec<_>>(), Relation::ALL);
        for row in &table.rows {
            assert_eq!((row.learned.counts.total(), row.baseline.counts.total()), (table.examples, table.examples));
            assert_eq!(row.learned.counts.true_percent(), row.baseline.counts.true_percent(), "one truth for both");
            assert_eq!(row.judged_by == JudgedBy::Rule, row.relation == Relation::Aligned);
            for figure in [row.learned.f1, row.baseline.f1, row.learned.sensitivity, row.baseline.specificity] {
                assert!(figure.value.is_none_or(|v| (0.0..=1.0).contains(&v)), "{row:?}");
                assert!(figure.interval.is_none_or(|[low, high]| low <= high), "{row:?}");
            }
        }
        // Left and right, and above and below, are each other's mirror images over all ordered pairs.
        for [a, b] in [[Relation::LeftOf, Relation::RightOf], [Relation::InFrontOf, Relation::Behind], [Relation::Above, Relation::Below]] {
            let holds = |r: Relation| table.rows[r.index()].baseline.counts.true_percent();
            assert_eq!(holds(a), holds(b));
        }
        assert_eq!(table, of(1));
    }
}
