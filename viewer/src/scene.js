// The picture: surface, openings, wires and the overlaid training shape.
import {
  BackSide,
  BufferAttribute,
  BufferGeometry,
  Color,
  DirectionalLight,
  FrontSide,
  Group,
  HemisphereLight,
  LineBasicMaterial,
  LineLoop,
  Mesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  PerspectiveCamera,
  Scene,
  SRGBColorSpace,
  Vector3,
  WebGLRenderer,
} from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';

import { colourAt } from './colours.js';

const FIELD_OF_VIEW = 30;
const INSIDE = 0.5; // brightness of the inside, seen through an opening
const MARGIN = 1.12; // of the picture's half height over that of the mean shape
const TURN = Math.PI / 24; // per key
const SEE_THROUGH = 0.22; // opacity
const WITHOUT = '#dbdee0'; // points without a value
const OVERLAY = '#d55e00';

export class Picture {
  constructor(model, canvas) {
    this.model = model;
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.renderer.outputColorSpace = SRGBColorSpace;
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(FIELD_OF_VIEW, 1, 0.1, 1e6);
    this.positions = new Float32Array(model.mean);
    this.overlayPositions = new Float32Array(model.mean);
    this.colours = new Float32Array(model.mean.length);
    this.buildSurface();
    this.buildOpenings();
    this.buildOverlay();
    this.buildLight();
    this.buildControls();
    this.pending = false;
  }

  buildSurface() {
    const { model } = this;
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(this.positions, 3));
    geometry.setAttribute('color', new BufferAttribute(this.colours, 3));
    geometry.setIndex(new BufferAttribute(model.faces, 1));
    let start = 0;
    model.parts.forEach((part, index) => {
      geometry.addGroup(start, 3 * part.faces, index);
      start += 3 * part.faces;
    });
    const offset = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 };
    const dimmed = (colour) => new Color(colour).multiplyScalar(INSIDE);
    this.materials = {
      part: {
        front: model.parts.map(
          ({ colour }) => new MeshLambertMaterial({ color: colour, side: FrontSide, ...offset }),
        ),
        back: model.parts.map(
          ({ colour }) =>
            new MeshLambertMaterial({ color: dimmed(colour), side: BackSide, ...offset }),
        ),
      },
      scalar: {
        front: model.parts.map(
          () => new MeshLambertMaterial({ vertexColors: true, side: FrontSide, ...offset }),
        ),
        back: model.parts.map(
          () =>
            new MeshLambertMaterial({
              vertexColors: true,
              color: dimmed('#ffffff'),
              side: BackSide,
              ...offset,
            }),
        ),
      },
    };
    this.geometry = geometry;
    this.front = new Mesh(geometry, this.materials.part.front);
    this.back = new Mesh(geometry, this.materials.part.back);
    this.wires = new Mesh(
      geometry,
      model.parts.map(
        () =>
          new MeshBasicMaterial({
            wireframe: true,
            color: '#000000',
            transparent: true,
            opacity: 0.28,
          }),
      ),
    );
    this.wires.visible = false;
    this.scene.add(this.front, this.back, this.wires);
  }

  buildOpenings() {
    this.openings = new Group();
    this.lineMaterial = new LineBasicMaterial({ color: '#1b2733' });
    this.model.openings.forEach(({ part, loop }) => {
      const geometry = new BufferGeometry();
      geometry.setAttribute('position', this.geometry.getAttribute('position'));
      geometry.setIndex(new BufferAttribute(loop, 1));
      const line = new LineLoop(geometry, this.lineMaterial);
      line.userData.part = part;
      this.openings.add(line);
    });
    this.scene.add(this.openings);
  }

  buildOverlay() {
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(this.overlayPositions, 3));
    geometry.setIndex(new BufferAttribute(this.model.faces, 1));
    this.overlay = new Mesh(
      geometry,
      new MeshBasicMaterial({ color: OVERLAY, wireframe: true, transparent: true, opacity: 0.45 }),
    );
    this.overlay.visible = false;
    this.scene.add(this.overlay);
  }

  buildLight() {
    this.scene.add(new HemisphereLight('#ffffff', '#8a8a92', 1.5));
    this.lamp = new DirectionalLight('#ffffff', 2.5); // moves with the eye
    this.scene.add(this.lamp, this.lamp.target);
  }

  buildControls() {
    const [right, up, eye] = this.model.views[0].map((row) => new Vector3(...row));
    const spanned = [Infinity, Infinity, -Infinity, -Infinity];
    const point = new Vector3();
    let radius = 0;
    for (let i = 0; i < this.model.mean.length; i += 3) {
      point.fromArray(this.model.mean, i);
      const x = point.dot(right);
      const y = point.dot(up);
      spanned[0] = Math.min(spanned[0], x);
      spanned[1] = Math.min(spanned[1], y);
      spanned[2] = Math.max(spanned[2], x);
      spanned[3] = Math.max(spanned[3], y);
      radius = Math.max(radius, point.length());
    }
    this.radius = radius;
    this.half = [0.5 * (spanned[2] - spanned[0]), 0.5 * (spanned[3] - spanned[1])];
    this.target = new Vector3()
      .addScaledVector(right, 0.5 * (spanned[0] + spanned[2]))
      .addScaledVector(up, 0.5 * (spanned[1] + spanned[3]));
    this.camera.up.copy(up);
    this.camera.near = 0.01 * radius;
    this.camera.far = 100 * radius;
    this.eyes = this.model.views.map((rows) => new Vector3(...rows[2]));
    this.camera.position.copy(this.target).add(eye);
    this.orbit = new OrbitControls(this.camera, this.canvas);
    this.orbit.minDistance = 0.5 * radius;
    this.orbit.maxDistance = 20 * radius;
    this.canvas.style.touchAction = 'pan-y'; // a finger can still scroll the page
    this.orbit.addEventListener('change', () => this.draw());
    this.canvas.addEventListener('webglcontextrestored', () => this.draw());
    this.canvas.addEventListener('keydown', (event) => this.onKey(event));
    this.look(0);
  }

  look(view) {
    const reach = MARGIN * Math.max(this.half[1], this.half[0] / this.camera.aspect);
    const away = reach / Math.tan((FIELD_OF_VIEW * Math.PI) / 360) + this.half[0];
    this.orbit.target.copy(this.target);
    this.camera.position.copy(this.target).addScaledVector(this.eyes[view], away);
    this.orbit.update();
    this.draw();
  }

  onKey(event) {
    const turns = {
      ArrowLeft: [-TURN, 0],
      ArrowRight: [TURN, 0],
      ArrowUp: [0, -TURN],
      ArrowDown: [0, TURN],
    };
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key in turns) this.turn(...turns[event.key]);
    else if (event.key === '+' || event.key === '=') this.zoom(1 / 1.15);
    else if (event.key === '-') this.zoom(1.15);
    else if (event.key === '0') this.look(0);
    else return;
    event.preventDefault();
  }

  turn(around, over) {
    const up = this.camera.up;
    const arm = this.camera.position.clone().sub(this.orbit.target);
    const elevation = arm.angleTo(up);
    const lifted = Math.min(Math.PI - 0.05, Math.max(0.05, elevation + over)) - elevation;
    const across = up.clone().cross(arm).normalize();
    arm.applyAxisAngle(across, lifted).applyAxisAngle(up, around);
    this.camera.position.copy(this.orbit.target).add(arm);
    this.orbit.update();
    this.draw();
  }

  zoom(factor) {
    const arm = this.camera.position.clone().sub(this.orbit.target).multiplyScalar(factor);
    arm.clampLength(this.orbit.minDistance, this.orbit.maxDistance);
    this.camera.position.copy(this.orbit.target).add(arm);
    this.orbit.update();
    this.draw();
  }

  resize(width, height) {
    if (width < 1 || height < 1) return;
    const narrow = Math.min(1, this.camera.aspect);
    this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio || 1));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    const arm = this.camera.position.clone().sub(this.orbit.target);
    arm.multiplyScalar(narrow / Math.min(1, this.camera.aspect));
    this.camera.position.copy(this.orbit.target).add(arm);
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  setTheme(isDark) {
    this.lineMaterial.color.set(isDark ? '#f2f6f8' : '#1b2733');
    this.draw();
  }

  // measured: null for the colours of the parts, else one number per point with the ends of the
  // scale, or the number of its colour; grey where there is none.
  setColours(measured) {
    const kind = measured ? 'scalar' : 'part';
    if (measured) {
      const { values, largest, smallest = 0, colours } = measured;
      const colour = new Color();
      const rgb = [0, 0, 0];
      for (let i = 0; i < values.length; i += 1) {
        if (Number.isNaN(values[i])) colour.set(WITHOUT);
        else if (colours) colour.set(colours[values[i]]);
        else {
          const span = largest - smallest;
          colourAt(span > 0 ? (values[i] - smallest) / span : 0, rgb, 0);
          colour.setRGB(rgb[0], rgb[1], rgb[2], SRGBColorSpace);
        }
        colour.toArray(this.colours, 3 * i);
      }
      this.geometry.getAttribute('color').needsUpdate = true;
    }
    this.front.material = this.materials[kind].front;
    this.back.material = this.materials[kind].back;
  }

  // look: 'solid', 'see-through' or 'hidden'.
  setPart(index, look) {
    const { part, scalar } = this.materials;
    [part.front, part.back, scalar.front, scalar.back].forEach((materials) => {
      const material = materials[index];
      material.visible = look !== 'hidden';
      material.transparent = look === 'see-through';
      material.opacity = material.transparent ? SEE_THROUGH : 1;
      material.depthWrite = !material.transparent;
      material.needsUpdate = true;
    });
    this.wires.material[index].visible = look !== 'hidden';
    this.openings.children
      .filter((line) => line.userData.part === index)
      .forEach((line) => Object.assign(line, { visible: look !== 'hidden' }));
    this.draw();
  }

  moved() {
    this.geometry.getAttribute('position').needsUpdate = true;
    this.geometry.computeVertexNormals();
    this.geometry.computeBoundingSphere();
    this.openings.children.forEach((line) => line.geometry.computeBoundingSphere());
    this.draw();
  }

  overlayMoved() {
    this.overlay.geometry.getAttribute('position').needsUpdate = true;
    this.overlay.geometry.computeBoundingSphere();
    this.draw();
  }

  draw() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      const right = new Vector3().setFromMatrixColumn(this.camera.matrixWorld, 0);
      this.lamp.position
        .copy(this.camera.position)
        .addScaledVector(this.camera.up, 0.8 * this.radius)
        .addScaledVector(right, -0.8 * this.radius);
      this.lamp.target.position.copy(this.orbit.target);
      this.renderer.render(this.scene, this.camera);
    });
  }
}
