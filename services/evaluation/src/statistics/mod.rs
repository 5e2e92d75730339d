//! What is computed of many trials: rates, quantiles, intervals, correlations, calibration, and the fit of forecasts.

pub mod assignment;
pub mod calibration;
pub mod correlation;
pub mod forecast_fit;
pub mod mask_faults;
pub mod mask_scores;
pub mod paired;
pub mod processor_time;
pub mod quantile;
pub mod rate;
pub mod resample;
