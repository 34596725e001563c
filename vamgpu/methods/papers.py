"""Citations."""

from __future__ import annotations

AUTOMATIC_EXPOSURE = "A. Orth et al., Automatic exposure volumetric additive manufacturing"
ROLL_TO_ROLL = "J. Toombs et al., Roll-to-roll tomographic volumetric additive manufacturing"
BAND = (
    "C. C. Li, J. Toombs, H. K. Taylor, T. J. Wallin, Tomographic projection optimization for volumetric additive "
    "manufacturing with general band constraint Lp-norm minimization, Additive Manufacturing 104447 (2024)"
)
RAMP = (
    "G. N. Ramachandran, A. V. Lakshminarayanan, Three-dimensional reconstruction from radiographs and electron "
    "micrographs, PNAS 68 (1971) 2236"
)
CAL = "B. E. Kelly et al., Volumetric additive manufacturing via tomographic reconstruction, Science 363 (2019) 1075"
CAL_FIRST = (
    "B. Kelly, I. Bhattacharya, M. Shusteff, R. M. Panas, H. K. Taylor, C. M. Spadaccini, Computed axial lithography "
    "(CAL): toward single step 3D printing of arbitrary geometries, arXiv:1705.05893 (2017)"
)
OBJECT_SPACE = (
    "C. M. Rackson et al., Object-space optimization of tomographic reconstructions for additive manufacturing, "
    "Additive Manufacturing 48 (2021) 102367"
)
PENALTY = (
    "I. Bhattacharya, J. Toombs, H. Taylor, High fidelity volumetric additive manufacturing, "
    "Additive Manufacturing 47 (2021) 102299"
)
THRESHOLDS = (
    "B. Nicolet, F. Wechsler, J. Madrid-Wolff, C. Moser, W. Jakob, Inverse rendering for tomographic volumetric "
    "additive manufacturing, ACM Trans. Graph. 43 (2024) 228"
)
NESTEROV = "Y. Nesterov, A method of solving a convex programming problem, Soviet Math. Dokl. 27 (1983) 372"
RESTART = (
    "B. O'Donoghue, E. Candès, Adaptive restart for accelerated gradient schemes, Found. Comput. Math. 15 (2015) 715"
)
TWO_METRIC = "D. P. Bertsekas, Projected Newton methods, SIAM J. Control Optim. 20 (1982) 221"
LIMITED_MEMORY = "D. C. Liu, J. Nocedal, On the limited memory BFGS method, Math. Program. 45 (1989) 503"
VIAL = "A. Orth et al., Correcting ray distortion in tomographic additive manufacturing, Opt. Express 29 (2021) 11037"
PRIMAL_DUAL = (
    "A. Chambolle, T. Pock, A first-order primal-dual algorithm for convex problems, "
    "J. Math. Imaging Vis. 40 (2011) 120"
)
DIAGONAL = (
    "T. Pock, A. Chambolle, Diagonal preconditioning for first order primal-dual algorithms in convex optimization, "
    "ICCV (2011) 1762"
)
ANCHORED = "H. Lu, J. Yang, Restarted Halpern PDHG for linear programming, arXiv:2407.16144 (2024)"
SAFE_STEPS = (
    "D. Applegate et al., Practical large-scale linear programming using primal-dual hybrid gradient, NeurIPS (2021)"
)
