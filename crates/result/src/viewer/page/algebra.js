// Vectors, and quaternions w, x, y, z. A view is { position, rotation }, world from camera, with
// the camera's x to the right, y down and z forward.
const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => scaled(a, 1 / (Math.hypot(...a) || 1));
const mixed = (a, b, t) => a.map((v, i) => v + t * (b[i] - v));

function product(a, b) {
  return [
    a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
    a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
    a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
    a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
  ];
}

const about = (axis, angle) => [Math.cos(angle / 2), ...scaled(axis, Math.sin(angle / 2))];

// Columns: the axes of the camera in the world.
function axesOf([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ];
}

const turned = (q, v) => axesOf(q).reduce((sum, axis, i) => add(sum, scaled(axis, v[i])), [0, 0, 0]);
const normal = q => q.map(v => v / Math.hypot(...q));

function slerp(a, b, t) {
  let cosine = a.reduce((sum, v, i) => sum + v * b[i], 0);
  const near = cosine < 0 ? b.map(v => -v) : b;
  cosine = Math.min(1, Math.abs(cosine));
  const angle = Math.acos(cosine), sine = Math.sin(angle);
  if (sine < 1e-4) return normal(mixed(a, near, t));
  const [s, u] = [Math.sin((1 - t) * angle) / sine, Math.sin(t * angle) / sine];
  return normal(a.map((v, i) => s * v + u * near[i]));
}

// Quaternion of the rotation with these columns.
function quaternionOf([x, y, z]) {
  const w = Math.sqrt(Math.max(0, 1 + x[0] + y[1] + z[2])) / 2;
  const size = (v, sign) => Math.sqrt(Math.max(0, v)) / 2 * (sign < 0 ? -1 : 1);
  return normal([
    w,
    size(1 + x[0] - y[1] - z[2], y[2] - z[1]),
    size(1 - x[0] + y[1] - z[2], z[0] - x[2]),
    size(1 - x[0] - y[1] + z[2], x[1] - y[0]),
  ]);
}
