//! Calibration campaigns: excitation, fuel optimisation, maps, controllers, validation
