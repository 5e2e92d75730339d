//! A cell and a ROS 2 system on `rmw_zenoh`, each as the other knows it.
