#version 300 es
// One triangle over the whole picture.
out vec2 place;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0;
  place = corner;
  gl_Position = vec4(2.0 * corner - 1.0, 0.0, 1.0);
}
