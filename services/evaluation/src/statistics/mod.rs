//! What is computed of many trials: rates, quantiles, intervals, correlations, calibration, and the fit of `best`'s stability.

pub mod assignment;
pub mod calibration;
pub mod correlation;
pub mod mask_faults;
pub mod mask_scores;
pub mod paired;
pub mod quantile;
pub mod rate;
pub mod resample;
pub mod stability_fit;
