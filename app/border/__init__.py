"""The distance buffer border: points around the mobile robot, their score, their file.

    dbb.py        P_i of Algorithm 1, and the border selected from it, (3)
    score.py      (9) to (11): the score of its points, and the coefficients of (9)
    nearest.py    the border as a continuous surface or, as in the paper, as points
    offset.py     that surface: the exact offset of l_m; mobile.py its distances
    contours.py   the point of its contours nearest to another: p_n of Algorithm 3
    sampling.py   P_i sampled sector by sector, on all cores; flood.py the flood of one sector
    cache.py      files of offline results; pairs and clouds of a robot, from a file or sampled
    reach.py      reachability maps for fitting (9)

(12) to (16) are in `app.avoidance.acting_point`.
"""
