//! The words of Repose, one noun per idea. Coordinate frames are in [`frames`](crate::frames).
//!
//! | noun | meaning |
//! |---|---|
//! | frame | one RGB-D picture of a camera ([`Frame`](crate::Frame)) |
//! | scene | what perception makes of a frame: labelled points, objects, surfaces, unseen space ([`Scene`](crate::Scene)). What the simulator makes, with true shapes, is a *simulated scene* |
//! | mask, label | the pixels of one object; the id that its pixels and points carry. Given masks come with the frame, found ones from perception |
//! | object, surface, obstacle | what can be moved and named; what things stand on; whatever else was seen and is in the way |
//! | support | the surface, or the object, that something rests on |
//! | query, anchor | the object that is to move; an object that the goal relates it to |
//! | goal, term | what must hold after a placement; one relation of it, to hold or not to hold ([`GoalTerm`](crate::GoalTerm)) |
//! | wish | a goal as the command line takes it: an object's id and its terms. On the wire there are only goals |
//! | placement | a pose for the query, as `placed_from_observed`. A *candidate* is one that the search has not judged yet |
//! | plan | the robot's motion that carries a placement out |
//! | arrangement | moves of several objects after which several goals hold together |
//! | sequence | goals that are carried out one after another, each planned on a fresh view; one *step* a goal |
//! | attempt | one try at a goal or at a call; an object that slips is given another |
//! | grasp candidate | a pose and opening of the hand that may hold the query, before motion has chosen one |
//! | support area | a support as motion sees it: an outline and a height, solid below |
//! | appearance | what words can say of an object: colors, extents, position |
//! | fault | what is wrong with an answer, or what a test breaks on purpose. A *failure* is why something was not done |
//! | condition | what is set up for a trial: an empty table, or one with large boxes |
//! | release | an object let go at a placement, in the simulator or by the robot. Its result is the *outcome* |
//! | trial | one run of a method on one problem of an evaluation |
//!
//! **How good a placement is.** Three nouns for three questions, and the number that the user gets:
//!
//! | noun | question | who answers |
//! |---|---|---|
//! | realism | Does the scene after the placement look like scenes that occur? 0 to 1 | the discriminator network (the paper's) |
//! | stability | Does the object stay where it was put? 0 to 1 | the stability model, fitted on simulated releases |
//! | outcome | What did happen to a released object: where it came to rest, and whether the goal held? | the simulator, or a view after execution |
//! | success | Will it stay, the goal hold and nothing else be disturbed? A calibrated probability | the planner, from all of these |
//!
//! **What the camera tells.** An object's far side, and what stands behind it, is not in any reading:
//!
//! | noun | meaning |
//! |---|---|
//! | reading | the depth of one pixel |
//! | seen | covered by readings: a surface that a ray ended on, or space that a ray went through. Everything else is *unseen*: neither free nor solid |
//! | view | a picture from one pose of the camera, and all that is derived from that pose; the *viewer's* frame gives left, right, front and behind |
//! | sight | whether something can be seen from there: the line of sight. Never a synonym of view |
//! | hidden | unseen because something else is in front of it; a part of unseen |
//!
//! **What is assumed of the unseen.**
//!
//! | noun | meaning |
//! |---|---|
//! | belief | a completed shape of what was seen in part; *believed* geometry is more than was seen |
//! | heeded | believed geometry that a step must keep clear of |
//! | keep-out zone | a box of the cell that no part of the arm, nor what it holds, may enter, whether or not anything was seen there |
//! | doubt | where a believed shape is a guess: places that more of the object may reach, or less of it |
