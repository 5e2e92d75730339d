//! The keys that a trial tries: every kind of key with the names that the roles bind, and with one that they do not.

use std::collections::BTreeSet;

use repose_proto::{Cell, Service};

use super::roles::Roles;

/// A key to try, and the one to listen at where it stands for several.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Probe {
    pub(super) key: String,
    pub(super) heard_at: String,
    /// Whether the router lets only so many a second through.
    pub(super) is_frame: bool,
}

impl Probe {
    /// Whether one put there would reach several keys.
    pub(super) fn is_broad(&self) -> bool {
        self.key != self.heard_at
    }
}

/// Every kind of key with the names that the roles bind, and with one that they do not.
pub(super) fn probes(roles: &Roles) -> Vec<Probe> {
    let users = || roles.users.values();
    let named = |names: Vec<&str>, other: &str| names.into_iter().chain([other]).map(str::to_owned).collect::<BTreeSet<String>>();
    let robots = named(users().filter_map(|u| u.robot.as_deref()).collect(), "check-robot");
    let cameras = named(users().flat_map(|u| u.cameras.iter().map(String::as_str)).collect(), "check-camera");
    let workers = named(users().filter_map(|u| u.worker.as_deref()).collect(), "check-worker");
    let (mut keys, mut frames) = (BTreeSet::new(), BTreeSet::new());
    let cells: BTreeSet<&String> = users().flat_map(|u| &u.cells).collect();
    for cell in cells.into_iter().filter_map(|name| Cell::new(name).ok()) {
        for robot in &robots {
            keys.extend([cell.robot_state(robot), cell.robot_command(robot), cell.robot_estop(robot)]);
        }
        keys.extend([cell.live_client("check"), cell.live_recorder("check")]);
        for camera in &cameras {
            keys.insert(cell.scene(camera));
            frames.insert(cell.camera_frame(camera));
        }
        for (service, worker) in Service::ALL.into_iter().flat_map(|s| workers.iter().map(move |w| (s, w))) {
            keys.extend([cell.call(service, worker), cell.load(service, worker), cell.cancel(service, worker, "check")]);
            keys.extend([cell.live(service, worker), cell.operate(service, worker), cell.journal(service, worker)]);
            // Calls for each cell that has a pool, and for one that does not.
            if service.is_poolable() && roles.pools.contains_key(cell.name()) {
                keys.extend(
                    named(roles.pools.values().flatten().map(String::as_str).collect(), "check-cell")
                        .iter()
                        .map(|other| cell.call_for(service, worker, other)),
                );
            }
        }
    }
    let narrow = |is_frame| move |key: String| Probe { heard_at: key.clone(), key, is_frame };
    let mut probes: Vec<Probe> = keys.into_iter().map(narrow(false)).chain(frames.into_iter().map(narrow(true))).collect();
    // One put that would stop every cell at once.
    let everywhere = probes.iter().find(|probe| probe.key.ends_with("@estop")).map(|probe| {
        let chunks: Vec<&str> = probe.key.split('/').enumerate().map(|(i, chunk)| if i == 2 { "*" } else { chunk }).collect();
        Probe { key: chunks.join("/"), heard_at: probe.key.clone(), is_frame: false }
    });
    probes.extend(everywhere);
    probes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bound_name_is_tried_and_one_that_is_not_bound() {
        let roles = Roles::parse(
            "router = \"r:1\"\ncells = [\"lab\"]\n[users.d]\nrole = \"driver\"\nrobot = \"panda\"\ncameras = [\"wrist\"]\n\
             [users.m]\nrole = \"service\"\nservice = \"motion\"\nworker = \"m-1\"\n",
        )
        .expect("roles");
        let probes = probes(&roles);
        let has = |key: &str| probes.iter().any(|probe| probe.key == key);
        assert!(has("repose/v1/lab/robot/panda/command") && has("repose/v1/lab/robot/check-robot/command"));
        assert!(has("repose/v1/lab/service/motion/m-1/operate") && has("repose/v1/lab/service/motion/check-worker/operate"));
        assert!(has("repose/v1/lab/service/motion/m-1/journal") && has("repose/v1/lab/live/recorder/check"), "calls have pictures in them");
        let frames: Vec<&str> = probes.iter().filter(|probe| probe.is_frame).map(|probe| probe.key.as_str()).collect();
        assert_eq!(frames, ["repose/v1/lab/camera/check-camera/frame", "repose/v1/lab/camera/wrist/frame"]);
        let broad: Vec<&Probe> = probes.iter().filter(|probe| probe.is_broad()).collect();
        assert_eq!((broad.len(), broad[0].key.as_str()), (1, "repose/v1/*/robot/check-robot/@estop"));
    }
}
