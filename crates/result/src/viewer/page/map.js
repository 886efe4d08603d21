// The map: from the page's text to texels, sorted by depth. Runs in a worker; where there is none,
// in the page.
function mapService(reply) {
  "use strict";
  const HALF = new Float32Array(1), HALF_BITS = new Uint32Array(HALF.buffer);
  let count = 0, means, radii, opacities, keys, depths, found;

  // Rounded to the nearest half float; too large values become the largest.
  function half(value) {
    HALF[0] = Math.min(value, 65504);
    const bits = HALF_BITS[0], sign = bits >>> 16 & 0x8000, magnitude = bits & 0x7fffffff;
    if (magnitude < 0x38800000) return sign | Math.round(Math.abs(HALF[0]) * 16777216);
    return sign | (magnitude - 0x38000000 + 0xfff + (magnitude >>> 13 & 1)) >>> 13;
  }

  function bytesOf(base64) {
    const bytes = new Uint8Array(Math.floor(base64.length / 4) * 3);
    let at = 0;
    for (let start = 0; start < base64.length; start += 1 << 20) {
      const text = atob(base64.slice(start, start + (1 << 20)));
      for (let i = 0; i < text.length; i++) bytes[at++] = text.charCodeAt(i);
    }
    return bytes.buffer;
  }

  // Ten texels each: rotation, spread and number of terms; then the coefficients of a term each.
  function viewTexels(cones, spreads, terms, coefficients) {
    const width = 2040, height = Math.max(1, Math.ceil(cones.length / 204));
    const texels = new Uint32Array(4 * width * height), floats = new Float32Array(texels.buffer);
    let from = 0;
    cones.forEach((cone, i) => {
      let to = 40 * i;
      texels[to] = cone;
      floats[to + 1] = spreads[i] / 65535;
      texels[to + 2] = terms[i];
      for (let k = 0; k < terms[i]; k++) {
        to += 4;
        for (let c = 0; c < 3; c++) floats[to + c] = coefficients[from++] / 2048;
      }
    });
    return { texels, width, height };
  }

  // The layout is that of quantise.rs.
  function decode({ base64, gaussians, viewColours, viewTerms, chunk, logarithmic, alphaMin }) {
    const buffer = bytesOf(base64);
    const chunks = Math.ceil(gaussians / chunk);
    let at = 0;
    const section = (Type, length) => {
      const array = new Type(buffer, at, length);
      at += array.byteLength;
      return array;
    };
    const bounds = section(Float32Array, 18 * chunks), rotations = section(Uint32Array, gaussians);
    const colours = section(Uint32Array, gaussians), cones = section(Uint32Array, viewColours);
    const places = section(Uint16Array, 3 * gaussians), spreads = section(Uint16Array, viewColours);
    const coefficients = section(Int16Array, 3 * viewTerms);
    const scales = section(Uint8Array, 3 * gaussians), shares = section(Uint8Array, gaussians);
    const views = viewTexels(cones, spreads, section(Uint8Array, viewColours), coefficients);
    const width = 2048, height = Math.max(1, Math.ceil(gaussians / 1024));
    const texels = new Uint32Array(4 * width * height), floats = new Float32Array(texels.buffer);
    count = gaussians;
    means = new Float32Array(3 * count);
    radii = new Float32Array(count);
    opacities = new Float32Array(count);
    keys = new Uint32Array(count);
    depths = new Float32Array(keys.buffer);
    found = new Uint32Array(count);
    const light = [0, 0, 0], logScale = [0, 0, 0];
    for (let i = 0; i < count; i++) {
      const of = Math.floor(i / chunk) * 18, to = 8 * i;
      const between = (k, share) => bounds[of + k] + share * (bounds[of + 9 + k] - bounds[of + k]);
      for (let k = 0; k < 3; k++) {
        floats[to + k] = means[3 * i + k] = between(k, places[3 * i + k] / 65535);
        logScale[k] = between(3 + k, scales[3 * i + k] / 255);
        const colour = between(6 + k, (colours[i] >>> 10 * k & 1023) / 1023);
        light[k] = half(logarithmic ? Math.exp(colour) : colour);
      }
      const opacity = opacities[i] = alphaMin + shares[i] / 255 * (1 - alphaMin);
      texels[to + 3] = rotations[i];
      texels[to + 4] = half(logScale[0]) | half(logScale[1]) << 16;
      texels[to + 5] = half(logScale[2]) | half(opacity) << 16;
      texels[to + 6] = light[0] | light[1] << 16;
      texels[to + 7] = light[2];
      radii[i] = Math.exp(Math.max(...logScale)) * Math.sqrt(2 * Math.log(opacity / alphaMin));
    }
    reply({ texels, width, height, views, viewColours }, [texels.buffer, views.texels.buffer]);
  }

  // Gaussians that can be seen, from the farthest to the nearest. `view`: rows of camera-from-world,
  // origin, bounds of x/z and y/z, nearest and farthest depth, size of a pixel at depth 1.
  function sort(view) {
    const [a, b, c, d, e, f, g, h, k] = view.rotation, [ox, oy, oz] = view.origin;
    const [left, top, right, bottom] = view.bounds;
    // A sphere beyond a side plane of the view is not seen.
    const lengths = view.bounds.map(v => Math.hypot(1, v));
    const pad = 3 * view.pixel;
    let n = 0, low = 0xffffffff, high = 0;
    for (let i = 0; i < count; i++) {
      const x = means[3 * i] - ox, y = means[3 * i + 1] - oy, z = means[3 * i + 2] - oz;
      const depth = g * x + h * y + k * z;
      if (!(depth >= view.near && depth <= view.far)) continue;
      const radius = radii[i] + pad * depth;
      const u = a * x + b * y + c * z, v = d * x + e * y + f * z;
      if (left * depth - u > radius * lengths[0] || u - right * depth > radius * lengths[2]) continue;
      if (top * depth - v > radius * lengths[1] || v - bottom * depth > radius * lengths[3]) continue;
      // The bits of positive floats are in their order.
      depths[n] = depth;
      const key = keys[n];
      if (key < low) low = key;
      if (key > high) high = key;
      found[n++] = i;
    }
    const order = new Uint32Array(n);
    if (n) {
      const shift = Math.max(0, 16 - Math.clz32(high - low)), top = high - low >>> shift;
      const starts = new Uint32Array(top + 2);
      for (let i = 0; i < n; i++) starts[top - (keys[i] - low >>> shift) + 1]++;
      for (let i = 1; i < starts.length; i++) starts[i] += starts[i - 1];
      for (let i = 0; i < n; i++) order[starts[top - (keys[i] - low >>> shift)]++] = found[i];
    }
    reply({ order, id: view.id }, [order.buffer]);
  }

  // Depth along the middle of the view at which half of the light comes from nearer; 0 if none does.
  function pivot({ origin, forward, pixel, id }) {
    const hits = [];
    for (let i = 0; i < count; i++) {
      const x = means[3 * i] - origin[0], y = means[3 * i + 1] - origin[1], z = means[3 * i + 2] - origin[2];
      const depth = x * forward[0] + y * forward[1] + z * forward[2];
      const reach = radii[i] + 4 * pixel * depth, apart = x * x + y * y + z * z - depth * depth;
      if (depth < 0.05 || apart > reach * reach) continue;
      hits.push([depth, opacities[i] * Math.exp(-4.5 * apart / (reach * reach))]);
    }
    hits.sort((a, b) => a[0] - b[0]);
    let open = 1;
    const hit = hits.find(([, alpha]) => (open *= 1 - alpha) < 0.5);
    reply({ depth: hit ? hit[0] : 0, pivot: id });
  }

  return message => {
    if (message.base64 !== undefined) decode(message);
    else if (message.forward) pivot(message);
    else sort(message);
  };
}
