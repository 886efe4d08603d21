#version 300 es
precision highp float;
uniform float alphaMin;
uniform float alphaMax;
in vec2 offset;
flat in vec4 light;
out vec4 blended;

void main() {
  float alpha = min(alphaMax, light.a * exp(-0.5 * dot(offset, offset)));
  if (alpha < alphaMin) discard;
  blended = vec4(light.rgb * alpha, alpha);
}
