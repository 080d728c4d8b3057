/* SPDX-License-Identifier: Apache-2.0
 *
 * LiDAR odometry: reads a ROS 1 bag, aligns each scan with planes in the cubes of a map, writes a pose for
 * each scan. It takes one argument, a file of settings, and knows nothing of SLAM Hive.
 *
 * Simple on purpose: replace it with your own.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void fail(const char *what, const char *which) {
    fprintf(stderr, "%s%s\n", what, which);
    exit(1);
}

/* ---- settings: lines of NAME = VALUE ---- */

static char bag_path[4096], topic[1024], poses_path[4096];
static double voxel, max_range;
static int iterations;

static void read_settings(const char *path) {
    FILE *file = fopen(path, "r");
    char line[8192];
    if (!file) fail("settings can't be read: ", path);
    while (fgets(line, sizeof line, file)) {
        char *equals = strstr(line, " = "), *value;
        line[strcspn(line, "\r\n")] = 0;
        if (!equals || line[0] == '#') continue;
        *equals = 0;
        value = equals + 3;
        if (!strcmp(line, "bag")) snprintf(bag_path, sizeof bag_path, "%s", value);
        else if (!strcmp(line, "topic")) snprintf(topic, sizeof topic, "%s", value);
        else if (!strcmp(line, "poses")) snprintf(poses_path, sizeof poses_path, "%s", value);
        else if (!strcmp(line, "voxel")) voxel = atof(value);
        else if (!strcmp(line, "max_range")) max_range = atof(value);
        else if (!strcmp(line, "iterations")) iterations = atoi(value);
        else fail("unknown setting: ", line);
    }
    fclose(file);
    if (!*bag_path || !*topic || !*poses_path || voxel <= 0 || max_range <= 0 || iterations < 1)
        fail("a setting is missing or not positive: bag, topic, poses, voxel, max_range, iterations in ", path);
}

/* ---- poses: p_to = R p_from + t ---- */

typedef struct { double R[9], t[3]; } Pose;
static const Pose identity = {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}};

static void apply(const Pose *a, const double p[3], double out[3]) {
    for (int i = 0; i < 3; i++)
        out[i] = a->R[3 * i] * p[0] + a->R[3 * i + 1] * p[1] + a->R[3 * i + 2] * p[2] + a->t[i];
}

static Pose times(const Pose *a, const Pose *b) {
    Pose c;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            c.R[3 * i + j] = a->R[3 * i] * b->R[j] + a->R[3 * i + 1] * b->R[3 + j] + a->R[3 * i + 2] * b->R[6 + j];
    apply(a, b->t, c.t);
    return c;
}

static Pose inverse(const Pose *a) {
    Pose c;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) c.R[3 * i + j] = a->R[3 * j + i];
    for (int i = 0; i < 3; i++)
        c.t[i] = -(c.R[3 * i] * a->t[0] + c.R[3 * i + 1] * a->t[1] + c.R[3 * i + 2] * a->t[2]);
    return c;
}

/* Make the rows of a rotation orthonormal again: without that, rounding grows from scan to scan. */
static void tidy(double R[9]) {
    for (int i = 0; i < 2; i++) {
        double *row = R + 3 * i, dot = 0, square = 0;
        for (int j = 0; j < 3; j++) dot += i ? row[j] * R[j] : 0;
        for (int j = 0; j < 3; j++) row[j] -= i ? dot * R[j] : 0, square += row[j] * row[j];
        for (int j = 0; j < 3; j++) row[j] /= sqrt(square);
    }
    R[6] = R[1] * R[5] - R[2] * R[4], R[7] = R[2] * R[3] - R[0] * R[5], R[8] = R[0] * R[4] - R[1] * R[3];
}

/* Rotation by the vector w (Rodrigues). */
static void rotation(const double w[3], double R[9]) {
    double angle = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]), x[3] = {0, 0, 0};
    double s = sin(angle), c = 1 - cos(angle);
    if (angle > 1e-12) for (int i = 0; i < 3; i++) x[i] = w[i] / angle;
    double K[9] = {0, -x[2], x[1], x[2], 0, -x[0], -x[1], x[0], 0};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double squared = K[3 * i] * K[j] + K[3 * i + 1] * K[3 + j] + K[3 * i + 2] * K[6 + j];
            R[3 * i + j] = (i == j) + s * K[3 * i + j] + c * squared;
        }
}

/* The vector of a small rotation. */
static void rotation_vector(const double R[9], double w[3]) {
    double cosine = (R[0] + R[4] + R[8] - 1) / 2, angle = acos(cosine > 1 ? 1 : cosine < -1 ? -1 : cosine);
    double scale = angle < 1e-9 ? 0.5 : angle / (2 * sin(angle));
    w[0] = scale * (R[7] - R[5]), w[1] = scale * (R[2] - R[6]), w[2] = scale * (R[3] - R[1]);
}

/* ---- map: cubes with the plane of the points in them ---- */

#define CUBES (1 << 18)
typedef struct { int used, x, y, z, planar; double n, sum[3], squares[6], mean[3], normal[3]; } Cube;
static Cube *map;
static int cubes;

static Cube *cube_at(int x, int y, int z, int make) {
    uint32_t place = ((uint32_t)x * 73856093u ^ (uint32_t)y * 19349663u ^ (uint32_t)z * 83492791u) % CUBES;
    while (map[place].used) {
        if (map[place].x == x && map[place].y == y && map[place].z == z) return &map[place];
        place = (place + 1) % CUBES;
    }
    if (!make || cubes > CUBES / 2) return NULL; /* memory is bounded: a full map takes nothing more in */
    cubes++;
    map[place].used = 1, map[place].x = x, map[place].y = y, map[place].z = z;
    return &map[place];
}

static void add_point(const double p[3]) {
    Cube *cube = cube_at((int)floor(p[0] / voxel), (int)floor(p[1] / voxel), (int)floor(p[2] / voxel), 1);
    if (!cube) return;
    cube->n += 1;
    for (int i = 0, k = 0; i < 3; i++) {
        cube->sum[i] += p[i];
        for (int j = i; j < 3; j++, k++) cube->squares[k] += p[i] * p[j];
    }
    cube->planar = -1; /* to be found when it is asked for */
}

/* The normal: the eigenvector of the least spread, by Jacobi's rotations. */
static void find_plane(Cube *cube) {
    double A[3][3], V[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int i = 0; i < 3; i++) cube->mean[i] = cube->sum[i] / cube->n;
    for (int i = 0, k = 0; i < 3; i++)
        for (int j = i; j < 3; j++, k++) A[i][j] = A[j][i] = cube->squares[k] / cube->n - cube->mean[i] * cube->mean[j];
    for (int sweep = 0; sweep < 8; sweep++)
        for (int p = 0; p < 2; p++)
            for (int q = p + 1; q < 3; q++) {
                if (fabs(A[p][q]) < 1e-15) continue;
                double theta = (A[q][q] - A[p][p]) / (2 * A[p][q]);
                double t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(theta * theta + 1));
                double c = 1 / sqrt(t * t + 1), s = t * c;
                for (int k = 0; k < 3; k++) {
                    double a = A[k][p], b = A[k][q];
                    A[k][p] = c * a - s * b, A[k][q] = s * a + c * b;
                }
                for (int k = 0; k < 3; k++) {
                    double a = A[p][k], b = A[q][k], v = V[k][p], w = V[k][q];
                    A[p][k] = c * a - s * b, A[q][k] = s * a + c * b;
                    V[k][p] = c * v - s * w, V[k][q] = s * v + c * w;
                }
            }
    int least = 0;
    for (int i = 1; i < 3; i++) if (A[i][i] < A[least][least]) least = i;
    double middle = 1e300;
    for (int i = 0; i < 3; i++) if (i != least && A[i][i] < middle) middle = A[i][i];
    for (int i = 0; i < 3; i++) cube->normal[i] = V[i][least];
    cube->planar = cube->n >= 6 && middle > 0.01 * voxel * voxel && A[least][least] < 0.1 * middle;
}

/* ---- alignment ---- */

static int solve(double A[6][7]) {
    for (int i = 0; i < 6; i++) {
        int best = i;
        for (int r = i + 1; r < 6; r++) if (fabs(A[r][i]) > fabs(A[best][i])) best = r;
        if (fabs(A[best][i]) < 1e-12) return 0;
        for (int k = 0; k < 7; k++) { double swap = A[i][k]; A[i][k] = A[best][k]; A[best][k] = swap; }
        for (int r = 0; r < 6; r++) {
            if (r == i) continue;
            double factor = A[r][i] / A[i][i];
            for (int k = i; k < 7; k++) A[r][k] -= factor * A[i][k];
        }
    }
    for (int i = 0; i < 6; i++) A[i][6] /= A[i][i];
    return 1;
}

static Pose align(const double *points, int count, Pose pose) {
    for (int round = 0; round < iterations; round++) {
        double A[6][7] = {{0}};
        int found = 0;
        for (int k = 0; k < count; k++) {
            double p[3], arm[3], J[6], error = 0, least = 4 * voxel * voxel;
            Cube *near = NULL;
            apply(&pose, points + 3 * k, p);
            int x = (int)floor(p[0] / voxel), y = (int)floor(p[1] / voxel), z = (int)floor(p[2] / voxel);
            for (int n = 0; n < 27; n++) {
                Cube *cube = cube_at(x + n % 3 - 1, y + n / 3 % 3 - 1, z + n / 9 - 1, 0);
                double far = 0;
                if (!cube) continue;
                if (cube->planar < 0) find_plane(cube);
                for (int i = 0; i < 3; i++) far += (p[i] - cube->mean[i]) * (p[i] - cube->mean[i]);
                if (cube->planar && far < least) least = far, near = cube;
            }
            if (!near) continue;
            found++;
            for (int i = 0; i < 3; i++) arm[i] = p[i] - pose.t[i], error += near->normal[i] * (near->mean[i] - p[i]);
            const double *n = near->normal;
            J[0] = arm[1] * n[2] - arm[2] * n[1], J[1] = arm[2] * n[0] - arm[0] * n[2], J[2] = arm[0] * n[1] - arm[1] * n[0];
            J[3] = n[0], J[4] = n[1], J[5] = n[2];
            double weight = 1 / (1 + error * error / (0.04 * voxel * voxel));
            weight *= weight; /* Geman-McClure: far ones count less */
            for (int i = 0; i < 6; i++) {
                for (int j = 0; j < 6; j++) A[i][j] += weight * J[i] * J[j];
                A[i][6] += weight * J[i] * error;
            }
        }
        if (found < 30) break;
        for (int i = 0; i < 6; i++) A[i][i] += 1e-6;
        if (!solve(A)) break;
        double w[3] = {A[0][6], A[1][6], A[2][6]}, most = 0;
        Pose turn = identity;
        rotation(w, turn.R);
        Pose turned = times(&turn, &pose);
        memcpy(pose.R, turned.R, sizeof pose.R);
        for (int i = 0; i < 3; i++) pose.t[i] += A[3 + i][6];
        for (int i = 0; i < 6; i++) if (fabs(A[i][6]) > most) most = fabs(A[i][6]);
        if (most < 1e-4) break;
    }
    return pose;
}

/* ---- odometry ---- */

static Pose pose = {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}}; /* of the LiDAR at the end of the last scan */
static Pose motion = {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}}; /* from the end of one scan to that of the next */
static double last_end = -1, interval = 0.1;
static int scans;

/* So much of the motion: 1 is all of it, -0.5 half of it and back. */
static Pose share_of_motion(double share) {
    double turn[3];
    Pose part = identity;
    rotation_vector(motion.R, turn);
    for (int i = 0; i < 3; i++) turn[i] *= share, part.t[i] = share * motion.t[i];
    rotation(turn, part.R);
    return part;
}

/* Take in a scan, its points after seconds after its stamp, and return the pose of the LiDAR at the stamp. */
static Pose take_scan(double stamp, double *points, const double *after, int count) {
    double length = 0;
    for (int k = 0; k < count; k++) if (after[k] > length) length = after[k];
    if (scans) interval = stamp + length - last_end;
    if (interval <= 0) fail("stamps do not increase on ", topic);
    for (int k = 0; k < count; k++) { /* to where they would be seen at the end, if it goes on as it went */
        Pose there = share_of_motion((after[k] - length) / interval);
        double moved[3];
        apply(&there, points + 3 * k, moved);
        memcpy(points + 3 * k, moved, sizeof moved);
    }
    Pose guess = times(&pose, &motion), back = inverse(&pose);
    pose = scans ? align(points, count, guess) : guess;
    tidy(pose.R);
    motion = times(&back, &pose);
    for (int k = 0; k < count; k++) {
        double p[3];
        apply(&pose, points + 3 * k, p);
        add_point(p);
    }
    last_end = stamp + length;
    scans++;
    Pose before = share_of_motion(-length / interval);
    return times(&pose, &before);
}

/* ---- the bag: http://wiki.ros.org/Bags/Format/2.0, and sensor_msgs/PointCloud2 in it ---- */

typedef struct { const unsigned char *at, *end; } Bytes;

static uint32_t u32(Bytes *b) {
    uint32_t value;
    if (b->end - b->at < 4) fail("the bag is damaged: ", bag_path);
    memcpy(&value, b->at, 4);
    b->at += 4;
    return value;
}

static Bytes part(Bytes *b) { /* a length, and so many bytes */
    uint32_t size = u32(b);
    Bytes found = {b->at, b->at + size};
    if ((size_t)(b->end - b->at) < size) fail("the bag is damaged: ", bag_path);
    b->at += size;
    return found;
}

static Bytes field(Bytes header, const char *name) {
    size_t size = strlen(name);
    while (header.at < header.end) {
        Bytes one = part(&header);
        if ((size_t)(one.end - one.at) > size && !memcmp(one.at, name, size) && one.at[size] == '=') {
            one.at += size + 1;
            return one;
        }
    }
    return (Bytes){NULL, NULL};
}

static double number(const unsigned char *at, int kind) { /* PointField's datatypes */
    float f;
    double d;
    uint32_t u;
    switch (kind) {
        case 6: memcpy(&u, at, 4); return u * 1e-9; /* drivers count ns in whole numbers */
        case 7: memcpy(&f, at, 4); return f;
        case 8: memcpy(&d, at, 8); return d;
    }
    return 0;
}

static double *points, *after;
static FILE *poses;

static void take_message(Bytes m) {
    int places[4] = {-1, -1, -1, -1}, kinds[4] = {0};
    u32(&m);
    double stamp = u32(&m);
    stamp += 1e-9 * u32(&m);
    part(&m);
    uint32_t height = u32(&m), width = u32(&m), fields = u32(&m);
    while (fields--) {
        Bytes name = part(&m);
        uint32_t offset = u32(&m);
        if (m.end - m.at < 5) fail("the bag is damaged: ", bag_path);
        int kind = *m.at;
        m.at += 5;
        int which = -1, size = (int)(name.end - name.at);
        if (size == 1 && *name.at >= 'x' && *name.at <= 'z') which = *name.at - 'x';
        if (size == 4 && !memcmp(name.at, "time", 4)) which = 3;
        if (which >= 0) places[which] = (int)offset, kinds[which] = kind;
    }
    m.at++;
    uint32_t step = u32(&m);
    u32(&m);
    Bytes data = part(&m);
    size_t count = (size_t)height * width;
    if (places[0] < 0 || places[1] < 0 || places[2] < 0) fail("no x, y, z in the clouds on ", topic);
    if (step < 12 || count * step > (size_t)(data.end - data.at)) fail("the bag is damaged: ", bag_path);
    points = realloc(points, (count + 1) * 3 * sizeof *points);
    after = realloc(after, (count + 1) * sizeof *after);
    if (!points || !after) fail("no memory for a cloud on ", topic);
    int kept = 0;
    for (size_t k = 0; k < count; k++) {
        const unsigned char *at = data.at + k * step;
        double *p = points + 3 * kept, far = 0;
        for (int i = 0; i < 3; i++) p[i] = number(at + places[i], kinds[i]), far += p[i] * p[i];
        if (!isfinite(far) || far > max_range * max_range) continue;
        after[kept++] = places[3] < 0 ? 0 : number(at + places[3], kinds[3]);
    }
    Pose found = take_scan(stamp, points, after, kept);
    for (int i = 0; i < 3; i++) {
        const double *row = found.R + 3 * i;
        fprintf(poses, "%s%.9f %.9f %.9f %.9f", i ? " " : "", row[0], row[1], row[2], found.t[i]);
    }
    fprintf(poses, "\n");
    fflush(poses); /* what is found stays, whatever happens next */
}

static uint32_t wanted[64];
static int connections;

static void take_records(Bytes b) {
    while (b.at < b.end) {
        Bytes header = part(&b), data = part(&b), op = field(header, "op");
        if (op.at == NULL) fail("the bag is damaged: ", bag_path);
        if (*op.at == 0x05) {
            Bytes packed = field(header, "compression");
            if (packed.end - packed.at != 4 || memcmp(packed.at, "none", 4)) fail("the bag is compressed: ", bag_path);
            take_records(data);
        } else if (*op.at == 0x07) {
            Bytes name = field(header, "topic"), id = field(header, "conn");
            int same = (size_t)(name.end - name.at) == strlen(topic) && !memcmp(name.at, topic, strlen(topic));
            int known = 0;
            uint32_t number = u32(&id);
            for (int k = 0; k < connections; k++) known |= wanted[k] == number;
            if (same && !known && connections < 64) wanted[connections++] = number;
        } else if (*op.at == 0x02) {
            Bytes id = field(header, "conn");
            uint32_t number = u32(&id);
            for (int k = 0; k < connections; k++) if (wanted[k] == number) take_message(data);
        }
    }
}

int main(int count, char **words) {
    if (count != 2) fail("usage: odometry SETTINGS", "");
    read_settings(words[1]);
    FILE *bag = fopen(bag_path, "rb");
    if (!bag) fail("the bag can't be read: ", bag_path);
    fseek(bag, 0, SEEK_END);
    long size = ftell(bag);
    rewind(bag);
    unsigned char *all = malloc(size > 0 ? (size_t)size : 1);
    if (!all || fread(all, 1, (size_t)size, bag) != (size_t)size) fail("the bag can't be read: ", bag_path);
    fclose(bag);
    if (size < 13 || memcmp(all, "#ROSBAG V2.0\n", 13)) fail("no ROS 1 bag: ", bag_path);
    map = calloc(CUBES, sizeof *map);
    poses = fopen(poses_path, "w");
    if (!map) fail("no memory for the map", "");
    if (!poses) fail("poses can't be written: ", poses_path);
    take_records((Bytes){all + 13, all + size});
    if (!connections) fail("the bag has no topic ", topic);
    if (!scans) fail("the bag has no message on ", topic);
    free(all), free(map), free(points), free(after);
    return fclose(poses) ? 1 : 0;
}
