// Entries of WIDTH neighboring voxels at once, on a processor, and quarter turns that map voxels and angles onto themselves.
typedef Vector Real;            // a number for each of the voxels
#define VLOAD PASTE(vload, WIDTH)
#define VSTORE PASTE(vstore, WIDTH)

// A turn by 90 degrees maps angle a to a + n / 4 and voxel (x, y) to (-y, x), if the angles are evenly spaced. Each has
// `width` numbers, first its cosine and sine. odd: remainder of the number of voxels along x and y.
static inline int folds_of(__global const float *angles, int width, int n, int n_x, int n_y, int odd) {
    if (n % 4 || n_x != n_y || n_x % 2 != odd) return 1;
    for (int angle = 0; angle < n; angle++) {
        __global const float *first = angles + width * angle, *turned = angles + width * ((angle + n / 4) % n);
        float off = fabs(turned[0] + first[1]) + fabs(turned[1] - first[0]);
        for (int k = 2; k < width; k++) off += fabs(turned[k] - first[k]);
        if (off > 1e-6f) return 1;
    }
    return 4;
}
static inline int turned_voxel(int fold, int x, int y, int n_y) {
    const int last = n_y - 1;
    return fold == 0 ? x * n_y + y : fold == 1 ? (last - y) * n_y + x
         : fold == 2 ? (last - x) * n_y + last - y : y * n_y + last - x;
}
