"""What a recording and a configuration show of each other before any estimator runs."""
