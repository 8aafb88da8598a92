"""Joint angles from arrays of accelerometers (Woods & Vikas): analytical, EKF, UKF, and a better model."""
