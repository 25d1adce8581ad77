/* Mass matrix and bias torque of an arm in one pass, for one arm (dynamics.c) and for four side by side (stop.c): NUMBER is the type,
 * OF(name) what a function for it is called, ALL(x) a constant; OF(sincos) is there.
 *
 * Everything is written about the base's origin in base coordinates: there the momenta of links add up without being
 * shifted or turned from frame to frame.
 *
 * Source: Featherstone (2008), ch. 2.10 (acceleration), 5.3 and 6.2, in base coordinates.
 */

/* Of one link, or of all from it on: mass, first moment, inertia, force and moment about the base's origin. */
typedef struct {
    NUMBER z[3], s[3]; /* joint screw: axis, velocity of the point at the base's origin */
    NUMBER m, h[3], I[6] /* xx yy zz xy xz yz */, f[3], t[3];
} OF(Link);

UNROLLED void OF(gather)(OF(Link) *to, const OF(Link) *from) {
    to->m += from->m;
    for (int k = 0; k < 3; k++) {
        to->h[k] += from->h[k];
        to->f[k] += from->f[k];
        to->t[k] += from->t[k];
    }
    for (int k = 0; k < 6; k++) to->I[k] += from->I[k];
}

/* The base's rotation `R`, carried on over a joint: first to its frame `R0` (3, 3), then about its `axis` (3,) by `angle` [rad]. */
UNROLLED void OF(turn)(NUMBER R[3][3], const double *R0, const double *axis, NUMBER angle) {
    NUMBER Q[3][3], E[3][3], s, c;
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 3; k++) Q[r][k] = R[r][0] * R0[k] + R[r][1] * R0[3 + k] + R[r][2] * R0[6 + k];
    OF(sincos)(angle, &s, &c);
    const NUMBER d = 1.0 - c;
    const double x = axis[0], y = axis[1], z = axis[2];
    E[0][0] = c + x * x * d;
    E[0][1] = x * y * d - z * s;
    E[0][2] = x * z * d + y * s;
    E[1][0] = y * x * d + z * s;
    E[1][1] = c + y * y * d;
    E[1][2] = y * z * d - x * s;
    E[2][0] = z * x * d - y * s;
    E[2][1] = z * y * d + x * s;
    E[2][2] = c + z * z * d;
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 3; k++) R[r][k] = Q[r][0] * E[0][k] + Q[r][1] * E[1][k] + Q[r][2] * E[2][k];
}

/* Mass matrix `M` (n, n) and `bias` (n,) from each link by itself: from the last on, joints feel all that they carry. */
UNROLLED void OF(project)(int n, OF(Link) *link, NUMBER *M, NUMBER *bias) {
    for (int i = n - 1; i >= 0; i--) {
        OF(Link) *k = link + i;
        if (i < n - 1) OF(gather)(k, k + 1);
        const NUMBER *z = k->z, *u = k->s, *h = k->h, *I = k->I;
        bias[i] = z[0] * k->t[0] + z[1] * k->t[1] + z[2] * k->t[2] + u[0] * k->f[0] + u[1] * k->f[1] + u[2] * k->f[2];
        const NUMBER px = k->m * u[0] + z[1] * h[2] - z[2] * h[1], py = k->m * u[1] + z[2] * h[0] - z[0] * h[2],
                     pz = k->m * u[2] + z[0] * h[1] - z[1] * h[0];
        const NUMBER lx = I[0] * z[0] + I[3] * z[1] + I[4] * z[2] + h[1] * u[2] - h[2] * u[1],
                     ly = I[3] * z[0] + I[1] * z[1] + I[5] * z[2] + h[2] * u[0] - h[0] * u[2],
                     lz = I[4] * z[0] + I[5] * z[1] + I[2] * z[2] + h[0] * u[1] - h[1] * u[0];
        for (int j = i; j >= 0; j--) {
            const NUMBER *y = link[j].z, *t = link[j].s;
            M[i * n + j] = M[j * n + i] = y[0] * lx + y[1] * ly + y[2] * lz + t[0] * px + t[1] * py + t[2] * pz;
        }
    }
}

UNROLLED void OF(mass_and_bias)(int n, const StopsetArm *arm, const NUMBER *pi, const NUMBER *q, const NUMBER *dq, NUMBER *M, NUMBER *bias) {
    OF(Link) link[SIM_JOINTS];
    NUMBER R[3][3] = {{ALL(1), ALL(0), ALL(0)}, {ALL(0), ALL(1), ALL(0)}, {ALL(0), ALL(0), ALL(1)}}, Q[3][3];
    NUMBER ox = ALL(0), oy = ox, oz = ox, wx = ox, wy = ox, wz = ox; /* origin; angular velocity */
    NUMBER ux = ox, uy = ox, uz = ox, ex = ox, ey = ox, ez = ox; /* velocity of the body's point at the base's origin; spatial acceleration */
    NUMBER ax = ALL(-arm->gravity[0]), ay = ALL(-arm->gravity[1]), az = ALL(-arm->gravity[2]);
    for (int i = 0; i < n; i++) {
        const double *p = arm->p + 3 * i;
        const NUMBER *P = pi + 10 * i;
        ox += R[0][0] * p[0] + R[0][1] * p[1] + R[0][2] * p[2];
        oy += R[1][0] * p[0] + R[1][1] * p[1] + R[1][2] * p[2];
        oz += R[2][0] * p[0] + R[2][1] * p[1] + R[2][2] * p[2];
        OF(turn)(R, arm->R + 9 * i, arm->axis + 3 * i, q[i]);
        const double x = arm->axis[3 * i], y = arm->axis[3 * i + 1], z = arm->axis[3 * i + 2];
        const NUMBER zx = R[0][0] * x + R[0][1] * y + R[0][2] * z, zy = R[1][0] * x + R[1][1] * y + R[1][2] * z,
                     zz = R[2][0] * x + R[2][1] * y + R[2][2] * z;
        const NUMBER sx = oy * zz - oz * zy, sy = oz * zx - ox * zz, sz = ox * zy - oy * zx;
        /* the screw turns with the links before it */
        const NUMBER v = dq[i], cx = wy * zz - wz * zy, cy = wz * zx - wx * zz, cz = wx * zy - wy * zx;
        ax += v * ((wy * sz - wz * sy) + (uy * zz - uz * zy));
        ay += v * ((wz * sx - wx * sz) + (uz * zx - ux * zz));
        az += v * ((wx * sy - wy * sx) + (ux * zy - uy * zx));
        ex += v * cx;
        ey += v * cy;
        ez += v * cz;
        wx += v * zx;
        wy += v * zy;
        wz += v * zz;
        ux += v * sx;
        uy += v * sy;
        uz += v * sz;
        /* the link's mass, first moment and inertia about the base's origin */
        const NUMBER m = P[0], gx = R[0][0] * P[1] + R[0][1] * P[2] + R[0][2] * P[3], gy = R[1][0] * P[1] + R[1][1] * P[2] + R[1][2] * P[3],
                     gz = R[2][0] * P[1] + R[2][1] * P[2] + R[2][2] * P[3];
        for (int r = 0; r < 3; r++) {
            Q[r][0] = R[r][0] * P[4] + R[r][1] * P[5] + R[r][2] * P[7];
            Q[r][1] = R[r][0] * P[5] + R[r][1] * P[6] + R[r][2] * P[8];
            Q[r][2] = R[r][0] * P[7] + R[r][1] * P[8] + R[r][2] * P[9];
        }
        const NUMBER t = 2.0 * (gx * ox + gy * oy + gz * oz) + m * (ox * ox + oy * oy + oz * oz);
        const NUMBER jxx = Q[0][0] * R[0][0] + Q[0][1] * R[0][1] + Q[0][2] * R[0][2] - 2.0 * gx * ox - m * ox * ox + t;
        const NUMBER jyy = Q[1][0] * R[1][0] + Q[1][1] * R[1][1] + Q[1][2] * R[1][2] - 2.0 * gy * oy - m * oy * oy + t;
        const NUMBER jzz = Q[2][0] * R[2][0] + Q[2][1] * R[2][1] + Q[2][2] * R[2][2] - 2.0 * gz * oz - m * oz * oz + t;
        const NUMBER jxy = Q[0][0] * R[1][0] + Q[0][1] * R[1][1] + Q[0][2] * R[1][2] - gx * oy - gy * ox - m * ox * oy;
        const NUMBER jxz = Q[0][0] * R[2][0] + Q[0][1] * R[2][1] + Q[0][2] * R[2][2] - gx * oz - gz * ox - m * ox * oz;
        const NUMBER jyz = Q[1][0] * R[2][0] + Q[1][1] * R[2][1] + Q[1][2] * R[2][2] - gy * oz - gz * oy - m * oy * oz;
        const NUMBER hx = gx + m * ox, hy = gy + m * oy, hz = gz + m * oz;
        /* momentum, then force = I a + v x* (I v) */
        const NUMBER px = m * ux + wy * hz - wz * hy, py = m * uy + wz * hx - wx * hz, pz = m * uz + wx * hy - wy * hx;
        const NUMBER lx = jxx * wx + jxy * wy + jxz * wz + hy * uz - hz * uy, ly = jxy * wx + jyy * wy + jyz * wz + hz * ux - hx * uz,
                     lz = jxz * wx + jyz * wy + jzz * wz + hx * uy - hy * ux;
        link[i] = (OF(Link)){
            {zx, zy, zz},
            {sx, sy, sz},
            m,
            {hx, hy, hz},
            {jxx, jyy, jzz, jxy, jxz, jyz},
            {m * ax + ey * hz - ez * hy + wy * pz - wz * py, m * ay + ez * hx - ex * hz + wz * px - wx * pz,
             m * az + ex * hy - ey * hx + wx * py - wy * px},
            {jxx * ex + jxy * ey + jxz * ez + hy * az - hz * ay + wy * lz - wz * ly + uy * pz - uz * py,
             jxy * ex + jyy * ey + jyz * ez + hz * ax - hx * az + wz * lx - wx * lz + uz * px - ux * pz,
             jxz * ex + jyz * ey + jzz * ez + hx * ay - hy * ax + wx * ly - wy * lx + ux * py - uy * px},
        };
    }
    OF(project)(n, link, M, bias);
}
