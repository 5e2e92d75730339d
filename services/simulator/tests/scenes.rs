//! Every kind of scene comes to rest where it should, can be seen, and is the same wherever it is made.

use std::sync::OnceLock;

use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_geometry::ViewerFrame;
use repose_proto::Relation;
use repose_simulator::render::picture;
use repose_simulator::scene::{KindWeights, SceneKind, SceneSettings, SimulatedScene, scene_of_seed};
use repose_simulator::viewpoint::{ViewpointSettings, random_viewpoint};

const SEEDS: std::ops::Range<u64> = 40..45;

/// Five scenes of every kind, made once for all tests.
fn scenes() -> &'static [SimulatedScene] {
    static SCENES: OnceLock<Vec<SimulatedScene>> = OnceLock::new();
    SCENES.get_or_init(|| {
        let of_kind = |kind| SEEDS.map(move |seed| scene_of_seed(seed, &SceneSettings::only(kind)).expect("a scene").0);
        SceneKind::ALL.into_iter().flat_map(of_kind).collect()
    })
}

#[test]
fn every_kind_gives_scenes_at_rest_on_its_furniture() {
    for kind in SceneKind::ALL {
        assert_eq!(scenes().iter().filter(|scene| scene.kind == kind).count(), 5, "{kind:?}");
    }
    for scene in scenes() {
        let (kind, seed) = (scene.kind, scene.seed);
        let wanted = match kind {
            SceneKind::Clutter => 7..=7,
            SceneKind::Desk | SceneKind::Pile => 8..=25,
            _ => 3..=7,
        };
        assert!(wanted.contains(&scene.objects.len()), "{kind:?} {seed}: {} objects", scene.objects.len());
        assert!(scene.penetration_m() <= 0.002, "{kind:?} {seed}");
        for object in &scene.objects {
            let at = object.world_from_object.translation.vector.into();
            assert!(scene.surfaces.iter().any(|s| s.is_under(&at, 0.0)), "{kind:?} {seed}: object {}", object.id);
        }
    }
}

#[test]
fn from_where_a_scene_says_to_look_most_objects_are_seen() {
    for kind in SceneKind::ALL {
        let (mut seen, mut all) = (0, 0);
        for scene in scenes().iter().filter(|scene| scene.kind == kind) {
            let mut rng = Pcg64::seed_from_u64(scene.seed);
            for _ in 0..4 {
                let (camera, world_from_camera) = random_viewpoint(&scene.focus(), &ViewpointSettings::default(), &mut rng);
                let picture = picture(&camera, &world_from_camera, &scene.drawables());
                let pixels = |id: u16| picture.labels.pixels().iter().filter(|label| **label == id).count();
                seen += scene.objects.iter().filter(|o| pixels(o.id) > 40).count();
                all += scene.objects.len();
            }
        }
        // A desk is wider than a picture on purpose, and a pile hides what is under it.
        let least_percent = match kind {
            SceneKind::Desk => 40,
            SceneKind::Pile => 60,
            _ => 75,
        };
        assert!(seen * 100 >= all * least_percent, "{kind:?}: {seen} of {all} are seen");
    }
}

#[test]
fn a_seed_gives_the_same_scene_on_every_thread() {
    let made = || -> Vec<(SceneKind, Vec<[f64; 3]>)> {
        let scene = |seed| scene_of_seed(seed, &SceneSettings::default()).expect("a scene").0;
        let at = |s: &SimulatedScene| s.objects.iter().map(|o| o.world_from_object.translation.vector.into()).collect();
        (0..6).map(scene).map(|s| (s.kind, at(&s))).collect()
    };
    let elsewhere = std::thread::spawn(made);
    assert_eq!(made(), elsewhere.join().expect("the other thread"));
}

#[test]
fn the_training_mix_leaves_kitchen_desk_and_pile_out_and_has_all_else() {
    assert_eq!(SceneSettings::default().kinds, KindWeights::training());
    const LEFT_OUT: [SceneKind; 3] = [SceneKind::Kitchen, SceneKind::Desk, SceneKind::Pile];
    assert_eq!(LEFT_OUT.map(|kind| KindWeights::training().weight(kind)), [0.0; 3]);
    for kind in SceneKind::ALL.into_iter().filter(|k| !LEFT_OUT.contains(k)) {
        assert!(KindWeights::training().weight(kind) > 0.05, "{kind:?}");
    }
}

#[test]
fn stacks_are_centered_and_neighbours_touch_often_enough_to_learn_from() {
    let (mut pairs, mut centered, mut touching) = (0, 0, 0);
    for seed in 100..120 {
        let (scene, _) = scene_of_seed(seed, &SceneSettings::default()).expect("a scene");
        let n = scene.objects.len();
        pairs += n * (n - 1);
        for holds in scene.relations(&ViewerFrame::from_yaw(0.0)) {
            centered += usize::from(holds[Relation::Centered.index()]);
            touching += usize::from(holds[Relation::Touching.index()]);
        }
    }
    assert!(centered * 100 >= pairs && touching * 100 >= pairs * 5, "{centered} centered and {touching} touching of {pairs}");
}
