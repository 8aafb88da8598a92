"""Joint angles from one IMU on each link: the passive complementary filter (Santaera et al. 2015)."""
