"""The distance buffer border: points around the mobile robot, their score, and stored files.

    dbb.py        P_i of Algorithm 1, and the border as selected points of P_i, (3)
    score.py      (9) to (11): the score of a point, and the coefficients of (9)
    nearest.py    the border as a continuous surface or, as in the paper, as points
    offset.py     the surface: the exact offset of l_m
    mobile.py     distances of points to l_m
    contours.py   the nearest point of a contour: p_n of Algorithm 3
    sampling.py   sampling of P_i on all cores, by a flood of each sector
    cache.py      files with the pairs and clouds of a robot
    reach.py      reachability maps and the fit of (9)

(12) to (16) are in `app.avoidance.acting_point`.
"""
