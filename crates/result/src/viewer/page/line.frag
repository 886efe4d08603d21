#version 300 es
precision mediump float;
uniform vec3 colour;
in float shade;
out vec4 blended;

void main() {
  blended = vec4(colour * shade, shade);
}
