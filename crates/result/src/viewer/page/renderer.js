// Draws a view: Gaussians blended in linear light (half floats), holes filled from coarser levels,
// then exposure, white balance and response, then lines.
const SOURCE = id => document.getElementById(id).textContent.trim();

class Renderer {
  constructor(canvas, scene, map) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, powerPreference: "high-performance" });
    if (!gl) throw new Error("This browser has no WebGL 2, which the 3D view needs.");
    if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float")) {
      throw new Error("This graphics processor cannot draw half floats, which the 3D view needs.");
    }
    Object.assign(this, { gl, canvas, scene, levels: [], size: [0, 0], count: 0, lines: 0 });
    this.splat = this.program("splat.vert", "splat.frag", ["corner", "index"]);
    this.halve = this.program("screen.vert", "halve.frag");
    this.copy = this.program("screen.vert", "copy.frag");
    this.tone = this.program("screen.vert", "tone.frag");
    this.line = this.program("line.vert", "line.frag", ["point", "strength"]);
    this.setMap(map);
    this.order = gl.createBuffer();
    this.rectangles = this.vertices(() => {
      this.attribute(0, 2, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]));
      gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
      gl.enableVertexAttribArray(1);
      gl.vertexAttribIPointer(1, 1, gl.UNSIGNED_INT, 0, 0);
      gl.vertexAttribDivisor(1, 1);
    });
    this.nothing = gl.createVertexArray();
  }

  program(vertex, fragment, attributes = []) {
    const { gl } = this, program = gl.createProgram();
    for (const [kind, id] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, SOURCE(id));
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    attributes.forEach((name, place) => gl.bindAttribLocation(program, place, name));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = gl.getAttachedShaders(program).map(shader => gl.getShaderInfoLog(shader));
      throw new Error("The 3D view cannot be set up: " + [gl.getProgramInfoLog(program), ...logs].join(" "));
    }
    const places = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      places[name] = gl.getUniformLocation(program, name);
    }
    return { program, places };
  }

  texture(format, width, height, layout, type, data, filter = this.gl.NEAREST) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, format, width, height, 0, layout, type, data);
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, filter);
    for (const key of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, key, gl.CLAMP_TO_EDGE);
    return texture;
  }

  vertices(define) {
    const { gl } = this, array = gl.createVertexArray();
    gl.bindVertexArray(array);
    define();
    gl.bindVertexArray(null);
    return array;
  }

  attribute(place, size, data) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, 0, 0);
  }

  // Gaussians as texels, in place of those before.
  setMap(map) {
    const { gl } = this;
    const texture = ({ texels, width, height }) =>
      this.texture(gl.RGBA32UI, width, height, gl.RGBA_INTEGER, gl.UNSIGNED_INT, texels);
    for (const before of [this.map, this.views]) if (before) gl.deleteTexture(before);
    Object.assign(this, { map: texture(map), views: texture(map.views), viewColours: map.viewColours });
  }

  // Gaussians to draw, the farthest first.
  setOrder(order) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
    this.count = order.length;
  }

  // Picture values by linear values: three lists of the same length.
  setResponse(channels) {
    const { gl } = this, length = channels[0].length, data = new Float32Array(4 * length);
    channels.forEach((values, c) => values.forEach((value, i) => data[4 * i + c] = value));
    if (this.response) gl.deleteTexture(this.response);
    this.response = this.texture(gl.RGBA32F, length, 1, gl.RGBA, gl.FLOAT, data);
  }

  // Line segments: points (3 numbers) and how visible each is.
  setLines(points, strengths) {
    this.lines = strengths.length;
    if (this.segments) this.gl.deleteVertexArray(this.segments);
    this.segments = this.vertices(() => {
      this.attribute(0, 3, new Float32Array(points));
      this.attribute(1, 1, new Float32Array(strengths));
    });
  }

  // Textures of the picture and its coarser levels.
  resize(width, height, levels) {
    const { gl } = this;
    if (this.size[0] === width && this.size[1] === height && this.levels.length === levels) return;
    for (const level of this.levels) {
      gl.deleteTexture(level.texture);
      gl.deleteFramebuffer(level.target);
    }
    this.size = [width, height];
    this.levels = [];
    for (let i = 0; i < levels; i++) {
      const texture = this.texture(gl.RGBA16F, width, height, gl.RGBA, gl.HALF_FLOAT, null, gl.LINEAR);
      const target = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, target);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
      this.levels.push({ texture, target, width, height });
      [width, height] = [Math.ceil(width / 2), Math.ceil(height / 2)];
    }
  }

  use({ program, places }, values) {
    const { gl } = this;
    gl.useProgram(program);
    for (const [name, value] of Object.entries(values)) {
      if (value instanceof WebGLTexture) continue;
      if (typeof value === "number") gl.uniform1f(places[name], value);
      else if (value.length === 9) gl.uniformMatrix3fv(places[name], true, value);
      else gl["uniform" + value.length + "fv"](places[name], value);
    }
    Object.entries(values).filter(([, v]) => v instanceof WebGLTexture).forEach(([name, texture], i) => {
      gl.activeTexture(gl.TEXTURE0 + i);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(places[name], i);
    });
    gl.activeTexture(gl.TEXTURE0);
  }

  target(level) {
    const { gl, canvas } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, level ? level.target : null);
    gl.viewport(0, 0, level ? level.width : canvas.width, level ? level.height : canvas.height);
  }

  triangle() {
    this.gl.bindVertexArray(this.nothing);
    this.gl.drawArrays(this.gl.TRIANGLES, 0, 3);
  }

  // `lens`: focal, principal, size [px], scale (pixels for one of the camera's).
  draw(view, lens, gain, showLines) {
    const { gl, scene } = this;
    const reach = Math.max(1, Math.round(Math.log2(16 * lens.scale)));
    this.resize(...lens.size, reach + 1);
    const position = { cameraFromWorld: axesOf(view.rotation).flat(), origin: view.position };
    const projection = { focal: lens.focal, principal: lens.principal, size: lens.size };
    gl.disable(gl.DEPTH_TEST);
    this.blend(position, projection, lens);
    this.fill();
    this.target(null);
    gl.disable(gl.BLEND);
    this.use(this.tone, { light: this.levels[0].texture, response: this.response, gain });
    this.triangle();
    if (showLines && this.lines) {
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      this.use(this.line, { ...position, ...projection, near: scene.near, colour: [1, 0.72, 0.38] });
      gl.bindVertexArray(this.segments);
      gl.drawArrays(gl.LINES, 0, this.lines);
    }
  }

  blend(position, projection, { focal, principal, size, scale }) {
    const { gl, scene } = this, [level] = this.levels;
    this.target(level);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const side = (axis, end) => (end * size[axis] - principal[axis]) / focal[axis];
    this.use(this.splat, {
      ...position, ...projection, map: this.map, views: this.views, viewColours: this.viewColours,
      rangeLow: [side(0, -0.15), side(1, -0.15)], rangeHigh: [side(0, 1.15), side(1, 1.15)],
      depthRange: [scene.near, scene.far], alphaMin: scene.alphaMin, alphaMax: scene.alphaMax,
      // The filter is that of the camera's pixels, so that every size shows the same picture.
      screenVariance: scene.screenVariance * Math.max(1, scale * scale),
    });
    gl.bindVertexArray(this.rectangles);
    if (this.count) gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
  }

  // Each level shows through the finer one where that is open.
  fill() {
    const { gl, levels } = this;
    gl.disable(gl.BLEND);
    for (let i = 1; i < levels.length; i++) {
      this.target(levels[i]);
      this.use(this.halve, { light: levels[i - 1].texture });
      this.triangle();
    }
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE_MINUS_DST_ALPHA, gl.ONE);
    for (let i = levels.length - 2; i >= 0; i--) {
      this.target(levels[i]);
      this.use(this.copy, { light: levels[i + 1].texture });
      this.triangle();
    }
  }
}
