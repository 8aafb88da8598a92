from jointest_ros.threads import one_for_matrices

one_for_matrices()  # before anything here imports numpy
