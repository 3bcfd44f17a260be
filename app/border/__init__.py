"""The distance buffer border: points around the mobile robot, their score, their file.

    dbb.py        P_i of Algorithm 1, and the border selected from it, (3)
    score.py      (9) to (11): the score of its points, and the coefficients of (9)
    surface.py    the border as a continuous surface, and as the paper has it
    contours.py   the point of either's contours nearest to another: p_n of Algorithm 3
    offset.py     the exact offset of l_m, which the border samples; mobile.py its distances
    sampling.py   P_i sampled sector by sector, on all cores; flood.py the flood of one sector
    cache.py      files of what is made offline; pairs and clouds of a robot, from one or sampled
    reach/        reachability maps, to which (9) is fitted

(12) to (16) are in `app.avoidance.mobile_acceleration`.
"""
