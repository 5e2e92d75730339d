//! dev only
use repose_evaluation::robot_scene::Condition;
use repose_evaluation::{RobotTableSettings, evaluate_robot};
use repose_inference::{Engine, HeldScene, InferenceConfig, SceneStore, engine_of};
use repose_planner::Models;
use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, Scene};
use repose_simulator::objects::{MeshLibrary, MeshSettings};
use std::sync::Arc;

struct Embedded {
    engine: Engine,
    store: SceneStore,
}
impl Embedded {
    fn held(&self, id: &str, scene: &Arc<Scene>) -> Result<Arc<HeldScene>, CallError> {
        self.store.get(id).or_else(|_| self.store.insert(id, Scene::clone(scene)))
    }
}
impl Models for Embedded {
    fn prior(&self, r: &PriorRequest, s: &Arc<Scene>) -> Result<PriorReply, CallError> {
        self.engine.prior(r, &*self.held(&r.scene.scene_id, s)?)
    }
    fn score(&self, r: &ScoreRequest, s: &Arc<Scene>) -> Result<ScoreReply, CallError> {
        self.engine.score(r, &*self.held(&r.scene.scene_id, s)?)
    }
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let seed: u64 = args[1].parse().unwrap();
    let number = |name: &str| std::env::var(name).ok().and_then(|v| v.parse::<f64>().ok());
    let models = Embedded { engine: engine_of(&InferenceConfig::default()).unwrap(), store: SceneStore::new(2, 1 << 30) };
    let library = MeshLibrary::load(std::path::Path::new("/work/shared/data/ycb"), &MeshSettings::default()).unwrap();
    let mut settings = RobotTableSettings { seed, ..RobotTableSettings::default() };
    match args[2].as_str() {
        "table" => settings.conditions = vec![Condition::Table],
        "large_box" => settings.conditions = vec![Condition::LargeBox],
        _ => {}
    }
    if let Some(only) = args.get(4).filter(|s| !s.is_empty()) {
        settings.objects = only.split(',').map(str::to_owned).collect();
    }
    if let Some(v) = number("GRIP") {
        settings.trial.motion.grip_force_n = v;
    }
    if let Some(v) = number("RELEASE") {
        settings.trial.motion.release_m = v;
    }
    if let Some(v) = number("COUNT") {
        settings.trial.count = v as u32;
    }
    if let Some(v) = number("TRIALS") {
        settings.trials = v as usize;
    }
    let table = evaluate_robot(&library, &settings, &models, |_, t, strip| {
        let outcome = t.cause.map_or("placed", repose_evaluation::robot_trial::Cause::name);
        let inc: Vec<String> = t.incidents.iter().map(|i| format!("\n    {} {:.1} s: {}", i.phase, i.at_s, i.what)).collect();
        println!(
            "{outcome}: {} {} seed {} goal {} off {:?} tilt {:?} in hand {:?} aside {:?} disturbed {} {:?} ms {:?} detail {}{}",
            t.object,
            t.condition.name(),
            t.seed,
            t.goal,
            t.off_m.map(|m| (m * 1e3).round()),
            t.tilt_rad.map(|m| (m * 1e2).round() / 1e2),
            t.in_hand.map(|s| ((s.by_m * 1e3).round(), (s.turn_rad * 100.0).round() / 100.0)),
            t.aside_m.map(|m| (m * 1e3).round()),
            t.disturbed,
            t.heeded,
            t.plan_ms.map(f64::round),
            t.detail,
            inc.concat()
        );
        if t.cause.is_some() && args[3] != "-" {
            let (w, h) = (strip[0].width(), strip[0].height());
            let mut out = image::RgbImage::new((w * strip.len()) as u32, h as u32);
            for (k, p) in strip.iter().enumerate() {
                for (i, c) in p.pixels().iter().enumerate() {
                    out.put_pixel((k * w + i % w) as u32, (i / w) as u32, image::Rgb(*c));
                }
            }
            out.save(format!("{}/{}_{}_{}_{}.png", args[3], seed, t.condition.name(), t.object, t.seed)).unwrap();
        }
    })
    .unwrap();
    for r in &table.overall {
        println!("{} plan {} grasp {} place {} end {} {:?}", r.condition.name(), r.plan, r.grasp, r.place, r.end_to_end, r.causes);
    }
}
