//! From the command line's wish to a request.

use repose_proto::PlaceRequest;
use repose_proto::place::Budget;

use crate::args::WishArgs;

impl WishArgs {
    /// The request on a scene.
    pub fn request(&self, scene_id: String) -> PlaceRequest {
        PlaceRequest {
            view_yaw_rad: self.view_yaw,
            count: self.count,
            rotation: self.rotation,
            seed: self.seed,
            variant: self.variant,
            min_clearance_m: self.min_clearance,
            budget: Budget { iterations: self.iterations, batch: self.batch, ..Budget::default() },
            ..PlaceRequest::new(scene_id, self.query, self.goal.clone())
        }
    }
}
