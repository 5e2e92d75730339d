//! Training of the relation predictor alone, on frozen encoders.
//!
//! Without gradients for the encoders, a view's clouds are encoded once, when the view is prepared, and all its ordered pairs are used: a core
//! processes a hundred times as many pairs as in the joint training. Pairs are of three kinds. *Standing* pairs are seen where they stand,
//! hiding parts of each other, as when a scene is described. *Apart* pairs are the paper's: the query from a picture without the other objects,
//! the anchor from the picture without the query. *Moved* pairs have the query's cloud from another place, turned and moved to where it rests,
//! as when a candidate for a placement is judged.

use candle_core::{Result, Tensor};
use nalgebra::{Point3, Rotation3};
use rand::RngExt;
use rand_pcg::Pcg64;
use repose_dataset::{Composite, ViewRecord};
use repose_geometry::{ViewerFrame, transform::yaw_of};
use repose_networks::{
    Kernel, Networks, NetworksConfig, PREDICTED_RELATIONS,
    crops::{Grouped, object_input},
    layers::Mode,
    pair_measures::{MeasuredCloud, pair_measures},
    points::{CloudConfig, ObjectCloud, Observer},
    relation_predictor::binary_cross_entropy,
    set_abstraction::Path,
};
use repose_proto::Relation;
use repose_relations::Confusion;
use repose_sensor::SensorModel;

use crate::{
    episode::{is_visible, observed, tilt},
    settings::TrainedPart,
    task::TrainingTask,
    views::QueryView,
};

/// How pairs are made and weighted. The values are ours; apart from `tilt_rad` (below) no comparison is recorded.
#[derive(Debug, Clone, Copy)]
pub struct RelationsTask {
    /// Border bands are 1 up to this many pixels wide.
    pub band_px: usize,
    /// Share of views as they were rendered: depth without faults and masks without bands, as in the paper's data.
    pub clean: f64,
    /// Share of views whose gravity is inexact. A calibrated camera's is exact; one that estimates it from the table is slightly off.
    pub tilted: f64,
    /// Standard deviation of gravity's tilt in those, radians. A degree would move the top of a stack by four times the millimetre of
    /// `centered`, and make that relation unlearnable.
    pub tilt_rad: f32,
    /// Objects with fewer points than this are in no pair.
    pub points_least: usize,
    /// The share of the query that must be visible elsewhere for a moved pair.
    pub visible_least: f64,
    /// Weight of the apart pairs' cross-entropy beside that of the standing ones.
    pub apart_weight: f64,
    /// Queries of a view that apart pairs are made of, at most.
    pub apart_queries: usize,
    /// Weight of the moved pairs' cross-entropy beside that of the standing ones.
    pub moved_weight: f64,
    /// Weight of the rare relations that are finer than a pixel (`touching`, `centered`), beside that of all nine.
    pub fine_weight: f64,
}

impl Default for RelationsTask {
    fn default() -> Self {
        Self {
            band_px: 2,
            clean: 0.3,
            tilted: 0.5,
            tilt_rad: 0.006,
            points_least: 10,
            visible_least: 0.5,
            apart_weight: 1.0,
            apart_queries: 2,
            moved_weight: 0.5,
            fine_weight: 1.0,
        }
    }
}

/// Pairs as the predictor reads them, row-major.
#[derive(Debug, Default)]
struct Rows {
    /// `[n, 128]`: queries with their centres relative to the anchors.
    queries: Vec<f32>,
    /// `[n, 128]`.
    anchors: Vec<f32>,
    /// `[n, 146]`.
    measures: Vec<f32>,
    /// `[n, 9]`: 0 or 1.
    labels: Vec<f32>,
}

impl Rows {
    fn extend(&mut self, more: Self) {
        self.queries.extend(more.queries);
        self.anchors.extend(more.anchors);
        self.measures.extend(more.measures);
        self.labels.extend(more.labels);
    }
}

/// The pairs of a view.
#[derive(Debug)]
pub struct ViewPairs {
    standing: Rows,
    apart: Rows,
    moved: Rows,
}

/// An object's cloud, and where its centroid is taken to be.
struct PlacedCloud {
    object: usize,
    cloud: ObjectCloud,
    position: Point3<f32>,
}

impl RelationsTask {
    /// The query seen alone, first, and the others without it.
    fn apart(&self, view: &ViewRecord, query: usize, camera: &Camera<'_>, rng: &mut Pcg64) -> Option<Vec<PlacedCloud>> {
        let mut clouds = camera.clouds(&mut Composite::of(view, |k| k == query), self.points_least, rng);
        clouds.extend(camera.clouds(&mut Composite::of(view, |k| k != query), self.points_least, rng));
        clouds.retain(|placed| view.is_seen(placed.object));
        clouds.first().is_some_and(|placed| placed.object == query).then_some(clouds)
    }

    /// The query from elsewhere, first, and all others.
    fn moved(&self, view: &ViewRecord, query: usize, camera: &Camera<'_>, rng: &mut Pcg64) -> Option<Vec<PlacedCloud>> {
        let elsewhere = view.objects[query].elsewhere.as_ref()?;
        let label = query as u16 + 1;
        let mut picture = Composite::of(view, |k| k != query);
        if !is_visible(&picture, &elsewhere.layer, label, self.visible_least) {
            return None;
        }
        picture.add(&elsewhere.layer, label);
        let mut clouds = camera.clouds(&mut picture, self.points_least, rng);
        let own = clouds.iter().position(|placed| placed.object == query)?;
        clouds.swap(0, own);
        let placed = &mut clouds[0];
        let in_world = camera.viewer_from_world.inverse() * placed.position;
        placed.position = camera.viewer_from_world * (elsewhere.placed_from_elsewhere.cast::<f32>() * in_world);
        placed.cloud = placed.cloud.turned(yaw_of(&elsewhere.placed_from_elsewhere) as f32);
        Some(clouds)
    }

    /// The loss of some pairs; `None` without pairs.
    fn loss_of(&self, networks: &Networks, rows: &[&Rows]) -> Result<Option<Tensor>> {
        let Some((logits, labels)) = logits_of(networks, rows)? else { return Ok(None) };
        let all = binary_cross_entropy(&logits, &labels)?;
        let fine = Relation::Touching.index()..PREDICTED_RELATIONS;
        let fine = |t: &Tensor| t.narrow(1, fine.start, fine.len())?.contiguous();
        (all + (binary_cross_entropy(&fine(&logits)?, &fine(&labels)?)? * self.fine_weight)?).map(Some)
    }
}

/// The camera and its faults that a view's clouds are seen with.
struct Camera<'a> {
    view: &'a ViewRecord,
    viewer_from_world: Rotation3<f32>,
    sensor: SensorModel,
    band_px: usize,
    cloud: CloudConfig,
}

impl Camera<'_> {
    /// The objects of a picture that show enough points.
    fn clouds(&self, picture: &mut Composite, points_least: usize, rng: &mut Pcg64) -> Vec<PlacedCloud> {
        let (points, labels) = observed(picture, self.view, &self.sensor, self.band_px, rng);
        let mut by_object = vec![Vec::new(); self.view.objects.len()];
        for (point, label) in points.iter().zip(labels) {
            if let Some(own) = usize::from(label).checked_sub(1).and_then(|k| by_object.get_mut(k)) {
                own.push(self.viewer_from_world * point);
            }
        }
        let observer = Observer::of_camera(&self.view.camera, &self.view.world_from_camera).turned(&self.viewer_from_world);
        let cloud = |(object, own): (usize, Vec<Point3<f32>>)| {
            let cloud = ObjectCloud::new(&own, &observer, &self.cloud).filter(|_| own.len() >= points_least)?;
            Some(PlacedCloud { object, position: cloud.centroid_in_viewer, cloud })
        };
        by_object.into_iter().enumerate().filter_map(cloud).collect()
    }
}

/// Encodes pairs (query, anchor) of clouds.
fn encoded(
    networks: &Networks,
    config: &NetworksConfig,
    view: &ViewRecord,
    clouds: &[PlacedCloud],
    pairs: &[(usize, usize)],
) -> Result<Rows> {
    let mut rows = Rows::default();
    if pairs.is_empty() {
        return Ok(rows);
    }
    let inputs: Vec<Grouped> = clouds.iter().map(|placed| object_input(Kernel::detect(), config, &placed.cloud)).collect();
    let device = &networks.device;
    let shapes = networks.object.shapes(&Grouped::concat(&inputs), &Mode::Serving, Path::of(device))?;
    let measured: Vec<MeasuredCloud> = clouds.iter().map(|placed| MeasuredCloud::new(&placed.cloud)).collect();
    let mut offsets = Vec::with_capacity(3 * pairs.len());
    for (query, anchor) in pairs {
        let offset: [f32; 3] = (clouds[*query].position - clouds[*anchor].position).into();
        offsets.extend(offset);
        rows.measures.extend(pair_measures(&measured[*query], &measured[*anchor], offset));
        let holds = &view.relations_of(clouds[*query].object, clouds[*anchor].object)[..PREDICTED_RELATIONS];
        rows.labels.extend(holds.iter().map(|holds| f32::from(u8::from(*holds))));
    }
    let centers = Tensor::from_vec(offsets, (pairs.len(), 3), device)?;
    let codes = |of: fn(&(usize, usize)) -> usize, centers: &Tensor| {
        let of: Vec<u32> = pairs.iter().map(|pair| of(pair) as u32).collect();
        let shapes = shapes.index_select(&Tensor::from_vec(of, pairs.len(), device)?, 0)?;
        networks.object.codes(&shapes, centers)?.flatten_all()?.to_vec1::<f32>()
    };
    rows.queries = codes(|(query, _)| *query, &centers)?;
    rows.anchors = codes(|(_, anchor)| *anchor, &centers.zeros_like()?)?;
    Ok(rows)
}

/// The pairs of the first cloud with every other.
fn of_first(clouds: &[PlacedCloud]) -> Vec<(usize, usize)> {
    (1..clouds.len()).map(|anchor| (0, anchor)).collect()
}

/// The predictor's logits of pairs, `[pairs, 9]`, and their labels; `None` without pairs.
fn logits_of(networks: &Networks, rows: &[&Rows]) -> Result<Option<(Tensor, Tensor)>> {
    let n = rows.iter().map(|r| r.labels.len()).sum::<usize>() / PREDICTED_RELATIONS;
    if n == 0 {
        return Ok(None);
    }
    let tensor = |of: fn(&Rows) -> &Vec<f32>| {
        let values: Vec<f32> = rows.iter().flat_map(|r| of(r)).copied().collect();
        let width = values.len() / n;
        Tensor::from_vec(values, (n, width), &networks.device)
    };
    let logits = networks.relations.logits(&tensor(|r| &r.queries)?, &tensor(|r| &r.anchors)?, &tensor(|r| &r.measures)?)?;
    Ok(Some((logits, tensor(|r| &r.labels)?)))
}

impl TrainingTask for RelationsTask {
    type Prepared = ViewPairs;

    fn part(&self) -> TrainedPart {
        TrainedPart::Relations
    }

    fn prepare(&self, networks: &Networks, config: &NetworksConfig, drawn: &QueryView<'_>, rng: &mut Pcg64) -> Result<Option<ViewPairs>> {
        let QueryView { view, query, .. } = drawn;
        let (sensor, band_px) = if rng.random_bool(self.clean) {
            (SensorModel::ideal(), 0)
        } else {
            (SensorModel::jittered(rng), rng.random_range(1..=self.band_px.max(1)))
        };
        let tilt = if rng.random_bool(self.tilted) { tilt(self.tilt_rad, rng) } else { Rotation3::identity() };
        let camera = Camera {
            view,
            viewer_from_world: tilt * ViewerFrame::from_yaw(view.view_yaw_rad).viewer_from_world().cast::<f32>(),
            sensor,
            band_px,
            cloud: CloudConfig { border_px: band_px as f32, ..config.cloud },
        };
        let mut clouds = camera.clouds(&mut Composite::of(view, |_| true), self.points_least, rng);
        clouds.retain(|placed| view.is_seen(placed.object));
        let ordered: Vec<_> = (0..clouds.len()).flat_map(|i| (0..clouds.len()).map(move |j| (i, j))).filter(|(i, j)| i != j).collect();
        let standing = encoded(networks, config, view, &clouds, &ordered)?;
        let clouds = self.moved(view, *query, &camera, rng).unwrap_or_default();
        let moved = encoded(networks, config, view, &clouds, &of_first(&clouds))?;
        let mut apart = Rows::default();
        for k in 0..self.apart_queries.min(view.objects.len()) {
            let clouds = self.apart(view, (query + k) % view.objects.len(), &camera, rng).unwrap_or_default();
            apart.extend(encoded(networks, config, view, &clouds, &of_first(&clouds))?);
        }
        Ok((!standing.labels.is_empty()).then_some(ViewPairs { standing, apart, moved }))
    }

    fn loss(
        &self,
        networks: &Networks,
        _: &NetworksConfig,
        prepared: &[&ViewPairs],
        samples: usize,
        _: &Mode,
        _: &mut Pcg64,
    ) -> Result<Tensor> {
        let drawn = &prepared[..samples.min(prepared.len())];
        let of = |rows: fn(&ViewPairs) -> &Rows| self.loss_of(networks, &drawn.iter().map(|view| rows(view)).collect::<Vec<_>>());
        let Some(mut loss) = of(|view| &view.standing)? else { candle_core::bail!("a micro-batch without a pair") };
        for (more, weight) in [(of(|view| &view.apart)?, self.apart_weight), (of(|view| &view.moved)?, self.moved_weight)] {
            if let Some(more) = more {
                loss = (loss + (more * weight)?)?;
            }
        }
        Ok(loss)
    }

    fn measure(&self, networks: &Networks, _: &NetworksConfig, prepared: &[ViewPairs], _: &mut Pcg64) -> Result<serde_json::Value> {
        let of = |rows: Vec<&Rows>| -> Result<(f64, serde_json::Value, usize)> {
            let loss = self.loss_of(networks, &rows)?.map_or(Ok(0.0), |loss| loss.to_scalar::<f32>())?;
            let mut counts = [Confusion::default(); PREDICTED_RELATIONS];
            let mut pairs = 0;
            if let Some((logits, labels)) = logits_of(networks, &rows)? {
                for (logits, labels) in logits.to_vec2::<f32>()?.iter().zip(labels.to_vec2::<f32>()?) {
                    pairs += 1;
                    counts.iter_mut().zip(logits.iter().zip(labels)).for_each(|(c, (logit, label))| c.count(*logit > 0.0, label > 0.5));
                }
            }
            Ok((f64::from(loss), serde_json::json!(counts.iter().map(Confusion::f1).collect::<Vec<_>>()), pairs))
        };
        let (standing, f1, pairs) = of(prepared.iter().map(|view| &view.standing).collect())?;
        let (apart, f1_apart, apart_pairs) = of(prepared.iter().map(|view| &view.apart).collect())?;
        let (moved, f1_moved, moved_pairs) = of(prepared.iter().map(|view| &view.moved).collect())?;
        Ok(serde_json::json!({
            "loss": standing + self.apart_weight * apart + self.moved_weight * moved,
            "f1": f1,
            "pairs": pairs,
            "f1_apart": f1_apart,
            "apart_pairs": apart_pairs,
            "f1_moved": f1_moved,
            "moved_pairs": moved_pairs,
            "views": prepared.len(),
        }))
    }
}
