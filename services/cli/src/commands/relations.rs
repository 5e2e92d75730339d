//! `repose relations`: every ordered pair's relations, learned and by rule.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use nalgebra::Point3;
use repose_evaluation::report::text::table;
use repose_geometry::ViewerFrame;
use repose_inference::HeldScene;
use repose_proto::scoring::{RealismBy, ScoreRequest};
use repose_proto::{Relation, Scene, SceneRef};
use repose_relations::{ObservedObject, observed};
use serde::Serialize;

use crate::embedded::{EmbeddedModels, NetworkArgs};
use crate::failure::{Failure, Outcome};
use crate::frames;
use crate::output::Output;

/// Arguments of `relations`.
#[derive(Debug, Args)]
pub struct RelationsArgs {
    /// The frame folder.
    pub frame: PathBuf,
    /// Which networks.
    #[command(flatten)]
    pub networks: NetworkArgs,
}

#[derive(Serialize)]
struct Pair {
    query: u16,
    anchor: u16,
    /// Probabilities.
    learned: Vec<f32>,
    rule: Vec<bool>,
}

/// Runs the command.
pub fn run(args: &RelationsArgs, output: Output) -> Outcome {
    let scene = frames::scene_of(&frames::read(&args.frame)?)?;
    let pairs = pairs_of(scene, &args.networks.models()?)?;
    output.print(&serde_json::json!({"pairs": pairs}), || {
        let names = Relation::ALL.iter().map(|relation| relation.as_str().replace('_', "\n"));
        let mut table = table(["query", "anchor"].map(str::to_owned).into_iter().chain(names));
        for pair in &pairs {
            let cell = |(p, rule): (&f32, &bool)| format!("{p:.2}{}", if *rule { " *" } else { "" });
            let cells = pair.learned.iter().zip(&pair.rule).map(cell);
            table.add_row([pair.query, pair.anchor].map(|id| id.to_string()).into_iter().chain(cells));
        }
        format!("{table}\nprobability that the query stands in the relation to the anchor; *: it does by rule")
    })
}

fn pairs_of(scene: Scene, models: &EmbeddedModels) -> Result<Vec<Pair>, Failure> {
    let viewer = ViewerFrame::from_yaw(scene.meta.view_yaw_rad);
    let ids: Vec<u16> = scene.meta.objects.iter().map(|o| o.id).collect();
    let by_rule: BTreeMap<u16, ObservedObject> = ids
        .iter()
        .filter_map(|id| Some((*id, ObservedObject::new(&scene.points_of(*id).map(Point3::from).collect::<Vec<_>>(), &viewer)?)))
        .collect();
    let held = HeldScene::new(scene.id(), Arc::new(scene));
    let mut pairs = Vec::new();
    for query in &ids {
        let anchors: Vec<u16> = ids.iter().copied().filter(|a| a != query).collect();
        let Some(object) = held.scene().object(*query) else { continue };
        let [x, y, z] = object.centroid_m.map(|c| c as f32);
        let request = ScoreRequest {
            scene: SceneRef { scene_id: held.scene_id().to_owned() },
            query: *query,
            anchors: anchors.clone(),
            view_yaw_rad: viewer.yaw_rad(),
            realism: false,
            realism_by: RealismBy::Discriminator,
            relations: true,
            candidates: vec![[x, y, z, 0.0]],
        };
        let reply = models.engine().score(&request, &held)?;
        for (anchor, learned) in anchors.iter().zip(&reply.relations) {
            let rule = observed(&by_rule[query], &by_rule[anchor]).to_vec();
            pairs.push(Pair { query: *query, anchor: *anchor, learned: learned.to_vec(), rule });
        }
    }
    Ok(pairs)
}
