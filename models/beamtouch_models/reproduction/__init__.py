"""The paper's figures 2 to 8, recomputed and compared with the paper."""
