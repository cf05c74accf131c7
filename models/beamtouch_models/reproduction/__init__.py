"""The paper's figures 2 to 8, computed anew and set beside what the paper says."""
