//! A robot of ROS with controllers that do as they are told, and with others.

mod controller;
mod hand;
mod start;
mod stop;
mod stream;
mod trial;
