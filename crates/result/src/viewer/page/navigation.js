// Moves the view: orbit about what is in the middle, shift, approach, fly, and glide to a camera.
class Navigation {
  constructor(stage, scene, changed, askPivot) {
    Object.assign(this, { stage, scene, changed, askPivot, keys: new Set(), pointers: new Map(), at: null, glide: null });
    const first = scene.frames[0];
    this.view = first ? viewOf(first) : { position: [0, 0, 0], rotation: [1, 0, 0, 0] };
    this.distance = 1;
    this.up = scene.up;
    this.listen();
  }

  forward() {
    return axesOf(this.view.rotation)[2];
  }

  pivot() {
    return add(this.view.position, scaled(this.forward(), this.distance));
  }

  // The view is now the user's.
  moved() {
    this.at = null;
    this.glide = null;
    this.changed();
  }

  // About the pivot: `x`, `y` [rad].
  orbit(x, y) {
    const pivot = this.pivot(), [right, , forward] = axesOf(this.view.rotation);
    const height = Math.acos(Math.max(-1, Math.min(1, dot(forward, this.up))));
    y = Math.max(0.1 - (Math.PI - height), Math.min(height - 0.1, y));
    const turn = product(about(this.up, x), about(right, y));
    this.view = {
      position: add(pivot, turned(turn, sub(this.view.position, pivot))),
      rotation: normal(product(turn, this.view.rotation)),
    };
    this.moved();
  }

  // By steps along the camera's axes.
  shift(x, y, z) {
    const axes = axesOf(this.view.rotation);
    const step = [x, y, z].reduce((sum, s, i) => add(sum, scaled(axes[i], s)), [0, 0, 0]);
    this.view = { ...this.view, position: add(this.view.position, step) };
    this.moved();
  }

  // By a factor towards the pivot, which moves on when it is near.
  approach(factor) {
    const least = 0.15 * this.scale, distance = Math.max(this.distance * factor, 0.02 * this.scale);
    const step = this.distance - distance;
    this.distance = Math.max(distance, least);
    this.shift(0, 0, step);
  }

  // To a view in so many milliseconds; `done` when it is there.
  glideTo(view, duration, done = () => {}, through = () => {}) {
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) duration = 0;
    this.at = null;
    this.glide = { from: this.view, to: view, duration, start: null, done, through };
    this.changed();
  }

  // One step of time; true while there is motion.
  advance(now) {
    const seconds = Math.min(0.1, (now - (this.last ?? now)) / 1000);
    this.last = now;
    if (this.glide) this.advanceGlide(now);
    const speed = 0.7 * this.scale * (this.keys.has("shift") ? 3 : 1) * seconds;
    const held = (plus, minus) => (this.keys.has(plus) ? 1 : 0) - (this.keys.has(minus) ? 1 : 0);
    const [x, y, z] = [held("d", "a"), held("q", "e"), held("w", "s")];
    if (x || y || z) this.shift(x * speed, y * speed, z * speed);
    const moving = Boolean(this.glide || x || y || z);
    if (!moving) this.last = undefined;
    return moving;
  }

  advanceGlide(now) {
    const { from, to, duration, done, through } = this.glide;
    this.glide.start ??= now;
    const t = duration ? Math.min(1, (now - this.glide.start) / duration) : 1;
    const eased = t * t * (3 - 2 * t);
    this.view = {
      position: mixed(from.position, to.position, eased),
      rotation: slerp(from.rotation, to.rotation, eased),
    };
    through(eased);
    if (t === 1) {
      this.view = to;
      this.glide = null;
      done();
    }
  }

  // Length by which motion is measured [m]: the distance of what the first camera shows.
  get scale() {
    return this.sceneScale ?? 1;
  }

  listen() {
    const { stage, pointers } = this;
    const local = event => [event.clientX, event.clientY];
    stage.addEventListener("pointerdown", event => {
      if (event.target.closest("button, a, [role=slider]")) return;
      if (!pointers.size) {
        this.travel = 0;
        this.askPivot();
      }
      pointers.set(event.pointerId, local(event));
      stage.setPointerCapture(event.pointerId);
      this.mode = event.button === 2 || event.ctrlKey || event.metaKey ? "shift" : "orbit";
    });
    stage.addEventListener("pointermove", event => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const now = local(event), others = [...pointers].filter(([id]) => id !== event.pointerId);
      pointers.set(event.pointerId, now);
      const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
      this.travel += Math.hypot(dx, dy);
      if (this.travel < 4) return;
      const pixel = this.distance * this.pixelSize();
      if (others.length) {
        // Two fingers: their middle shifts, their distance approaches.
        const [other] = others[0].slice(1), span = p => Math.max(20, Math.hypot(p[0] - other[0], p[1] - other[1]));
        this.approach(span(before) / span(now));
        this.shift(-dx / 2 * pixel, -dy / 2 * pixel, 0);
      } else if (this.mode === "shift") this.shift(-dx * pixel, -dy * pixel, 0);
      else this.orbit(-dx * 0.006, dy * 0.006);
    });
    const end = event => {
      if (pointers.delete(event.pointerId) && event.type === "pointerup" && this.travel < 4 && !pointers.size) {
        this.clicked?.(local(event));
      }
    };
    for (const type of ["pointerup", "pointercancel"]) stage.addEventListener(type, end);
    stage.addEventListener("contextmenu", event => event.preventDefault());
    stage.addEventListener("wheel", event => {
      event.preventDefault();
      if (!this.wheeling) this.askPivot();
      clearTimeout(this.wheeling);
      this.wheeling = setTimeout(() => this.wheeling = null, 250);
      const lines = event.deltaMode === 1 ? 16 : 1;
      this.approach(Math.exp(Math.max(-80, Math.min(80, event.deltaY * lines)) * 0.002));
    }, { passive: false });
    const held = "wasdqe";
    addEventListener("keydown", event => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const key = event.key.toLowerCase();
      if (key === "shift") this.keys.add(key);
      if (key.length !== 1 || !held.includes(key)) return;
      this.keys.add(key);
      this.changed();
    });
    addEventListener("keyup", event => this.keys.delete(event.key.toLowerCase()));
    addEventListener("blur", () => this.keys.clear());
  }
}

const viewOf = frame => ({ position: frame.position, rotation: frame.rotation });

// A view from behind and above the cameras, towards what they see.
function overview(frames, distance, up) {
  const mean = of => scaled(frames.reduce((sum, f) => add(sum, of(f)), [0, 0, 0]), 1 / frames.length);
  const middle = mean(f => f.position), forward = unit(mean(f => axesOf(f.rotation)[2]));
  const spread = Math.max(...frames.map(f => Math.hypot(...sub(f.position, middle))));
  const target = add(middle, scaled(forward, 0.6 * distance));
  const back = 0.7 * distance + 2 * spread;
  const position = add(middle, add(scaled(forward, -back), scaled(up, 0.4 * back)));
  const z = unit(sub(target, position)), x = unit(cross(z, up));
  return { position, rotation: quaternionOf([x, cross(z, x), z]) };
}

// Segments of the path and of the cameras, as pyramids with a mark at the upper edge; the current one
// is brighter.
function lineWork(scene, size, current) {
  const points = [], strengths = [];
  const segment = (a, b, strength) => {
    points.push(...a, ...b);
    strengths.push(strength, strength);
  };
  scene.path.slice(1).forEach((point, i) => segment(scene.path[i], point, 0.8));
  const { width, height, fx, fy, cx, cy } = scene.camera;
  const apart = Math.ceil(scene.frames.length / MAX_PYRAMIDS);
  scene.frames.forEach((frame, i) => {
    if (i % apart && i !== current) return;
    const strength = i === current ? 1 : 0.35;
    const corner = (u, v) => add(frame.position, turned(frame.rotation, scaled([(u - cx) / fx, (v - cy) / fy, 1], size)));
    const corners = [corner(0, 0), corner(width, 0), corner(width, height), corner(0, height)];
    corners.forEach((c, k) => {
      segment(frame.position, c, strength);
      segment(c, corners[(k + 1) % 4], strength);
    });
    const top = corner(width / 2, -0.18 * height);
    segment(corners[0], top, strength);
    segment(top, corners[1], strength);
  });
  return { points, strengths };
}

// Cameras that are drawn: more would hide each other.
const MAX_PYRAMIDS = 24;
