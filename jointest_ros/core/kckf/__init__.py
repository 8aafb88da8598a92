"""Estimators on link gyros and Hall sensors: `gyro`, `hall`, `kf`, `kckf` (Yumbla et al. 2023)."""
