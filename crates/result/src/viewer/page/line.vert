#version 300 es
// Cameras and path, by the pinhole projection of the view.
precision highp float;
uniform mat3 cameraFromWorld;
uniform vec3 origin;
uniform vec2 focal;
uniform vec2 principal;
uniform vec2 size;
uniform float near;
in vec3 point;
in float strength;
out float shade;

void main() {
  vec3 p = cameraFromWorld * (point - origin);
  vec2 pixel = focal * p.xy + principal * p.z;
  gl_Position = vec4(2.0 * pixel.x / size.x - p.z, p.z - 2.0 * pixel.y / size.y, p.z - 2.0 * near, p.z);
  shade = strength;
}
