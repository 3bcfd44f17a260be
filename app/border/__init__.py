"""The distance buffer border: points around the mobile robot, their score, their file.

    dbb.py        P_i of Algorithm 1, and the border selected from it, (3)
    score.py      (9) to (11): the score of its points, and the coefficients of (9)
    nearest.py    the border as a continuous surface or as the paper has it, points
    offset.py     that surface: the exact offset of l_m; mobile.py its distances
    contours.py   the point of its contours nearest to another: p_n of Algorithm 3
    sampling.py   P_i sampled sector by sector, on all cores; flood.py the flood of one sector
    cache.py      files of what is made offline; pairs and clouds of a robot, from one or sampled
    reach/        reachability maps, to which (9) is fitted

(12) to (16) are in `app.avoidance.acting_point`.
"""
