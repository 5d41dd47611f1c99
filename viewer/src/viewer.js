// The interactive view of a report: controls and what they do.
import { paintScale } from './colours.js';
import {
  addScaled,
  cycleAt,
  distance,
  fillDistances,
  fillShape,
  quantile,
  readModel,
  scoresIn,
} from './data.js';
import { Picture } from './scene.js';

const LIMIT = 3; // standard deviations
const SECONDS_PER_CYCLE = 2;
const CALM_STEPS = 8; // of a cycle, one a second, where the reader asked for less motion

function element(name, properties = {}, ...children) {
  const { dataset, ...rest } = properties;
  const made = Object.assign(document.createElement(name), rest);
  Object.assign(made.dataset, dataset);
  made.append(...children);
  return made;
}

function choice(label, names, onChange) {
  const select = element('select');
  names.forEach((name, index) => select.append(new Option(name, String(index))));
  select.addEventListener('change', () => onChange(Number(select.value)));
  return [element('label', {}, label, select), select];
}

function tick(label, isOn, onChange) {
  const box = element('input', { type: 'checkbox', checked: isOn });
  box.addEventListener('change', () => onChange(box.checked));
  return [element('label', {}, box, ` ${label}`), box];
}

function group(title, ...children) {
  return element('fieldset', {}, element('legend', { textContent: title }), ...children);
}

const signed = (value) =>
  `${value > 0 ? '+' : value < 0 ? '\u2212' : ''}${Math.abs(value).toFixed(2)} sd`;

const endText = (value) => String(Number(value.toPrecision(3))).replace('-', '\u2212');

// What the points can be coloured by; `measure` gives one number in mm per point.
const COLOURINGS = [
  { label: 'part' },
  {
    label: 'distance from the mean shape',
    title: 'distance from the mean shape (mm)',
    measure: (viewer) =>
      viewer.distancesFrom(viewer.set.mean, 2 * viewer.most(viewer.set.spread)),
  },
  {
    label: 'standard deviation of the points',
    title: 'standard deviation (mm)',
    measure: ({ set, most }) => ({ values: set.spread, largest: most(set.spread) }),
  },
  {
    label: 'left-out error of the points',
    title: 'error of left-out shapes, RMS (mm)',
    needs: (model) => Boolean(model.error),
    measure: ({ model }) => ({
      values: model.error,
      largest: quantile(model.error, 0.99),
      isOpen: true,
    }),
  },
  {
    label: 'distance from the training shape',
    title: 'distance from the training shape (mm)',
    needs: (model) => model.shapes.length > 0,
    measure: (viewer) =>
      viewer.shape &&
      viewer.distancesFrom(viewer.shape.scores, 0.5 * viewer.most(viewer.set.spread)),
  },
];

// A field of the surface: the training shape's own where one is chosen and the page carries it.
function fieldColouring(field) {
  const { labels, colours, ends = [] } = field;
  return {
    label: field.name,
    measure: ({ model, shape }) => {
      const own = shape && field.shapes[model.shapes.indexOf(shape)];
      const mean = labels ? 'most frequent label' : 'mean of the shapes';
      return {
        title: `${field.title}, ${own ? 'of the training shape' : mean}`,
        values: own || field.mean,
        smallest: ends[0],
        largest: ends[1],
        labels,
        colours,
        isOpen: true,
      };
    },
  };
}

class Viewer {
  constructor(root, model) {
    this.root = root;
    this.model = model;
    this.set = model.sets[0];
    this.scores = this.set.modes.map(() => 0);
    this.cycle = null; // frames of the cycle that the sliders are added to, or null for the mean
    this.time = 0;
    this.shape = null;
    this.timer = 0;
    this.calm = window.matchMedia('(prefers-reduced-motion: reduce)');
    this.canvas = element('canvas', {
      tabIndex: 0,
      ariaLabel:
        'Shape of the model in three dimensions; arrow keys turn it, plus and minus zoom, 0 resets',
    });
    this.canvas.setAttribute('role', 'img');
    this.legend = element('div', { className: 'legend' });
    this.stage = element('div', { className: 'stage' }, this.canvas, this.legend);
    this.picture = new Picture(model, this.canvas);
    this.referencePoints = new Float32Array(model.mean);
    this.measured = new Float32Array(model.points);
    this.form = element('form', { ariaLabel: 'Controls of the view' });
    this.form.addEventListener('submit', (event) => event.preventDefault());
    this.form.append(
      this.modeControls(),
      ...(model.cycles.length ? [this.cycleControls()] : []),
      this.lookControls(),
      ...(model.parts.length > 1 ? [this.partControls()] : []),
      ...(model.shapes.length ? [this.shapeControls()] : []),
    );
    root.append(this.stage, this.form);
    const dark = window.matchMedia('(prefers-color-scheme: dark)');
    dark.addEventListener('change', () => this.picture.setTheme(dark.matches));
    this.picture.setTheme(dark.matches);
    this.buildSliders();
    root.classList.add('ready');
    this.picture.resize(this.stage.clientWidth, this.stage.clientHeight);
    this.picture.look(0);
    new ResizeObserver(() => {
      this.picture.resize(this.stage.clientWidth, this.stage.clientHeight);
    }).observe(this.stage);
    this.update();
  }

  modeControls() {
    this.sliders = element('div');
    const reset = element('button', { type: 'button', textContent: 'Mean shape' });
    reset.addEventListener('click', () => this.setScores(this.scores.map(() => 0)));
    const children = [this.sliders, element('div', { className: 'row' }, reset)];
    if (this.model.sets.length > 1) {
      const [label] = choice(
        'Variation of ',
        this.model.sets.map((set) => set.label),
        (index) => this.chooseSet(index),
      );
      children.unshift(label);
    }
    return group('Modes', ...children);
  }

  cycleControls() {
    const names = ['mean shape', ...this.model.cycles.map((cycle) => cycle.label)];
    const [label, select] = choice('Modes are added to the ', names, (index) =>
      this.chooseCycle(index - 1),
    );
    this.cycleSelect = select;
    this.phase = element('input', { type: 'range', min: 0, max: 1, step: 0.01, value: 0 });
    this.phaseText = element('span', { className: 'value', ariaHidden: 'true' });
    this.phase.addEventListener('input', () => {
      if (!this.cycle) this.chooseCycle(0);
      this.time = Number(this.phase.value);
      this.update();
    });
    this.button = element('button', { type: 'button', textContent: 'Play' });
    this.button.addEventListener('click', () => (this.timer ? this.pause() : this.play()));
    const name = element('span', { textContent: 'Time in the cycle' });
    return group(
      'Cycle',
      label,
      element('label', { className: 'mode' }, name, this.phaseText, this.phase),
      element('div', { className: 'row' }, this.button),
    );
  }

  lookControls() {
    this.colourings = [
      ...COLOURINGS.filter(({ needs }) => !needs || needs(this.model)),
      ...this.model.fields.map(fieldColouring),
    ];
    const [colour, select] = choice(
      'Colour ',
      this.colourings.map(({ label }) => label),
      (index) => {
        this.colouring = this.colourings[index];
        this.update();
      },
    );
    this.colourSelect = select;
    this.colouring = this.colourings[0];
    const [wires] = tick('wireframe', false, (isOn) => {
      this.picture.wires.visible = isOn;
      this.picture.draw();
    });
    const [openings] = tick('openings and seams', true, (isOn) => {
      this.picture.openings.visible = isOn;
      this.picture.draw();
    });
    const views = ['Front', 'Side'].map((name, index) => {
      const button = element('button', { type: 'button', textContent: name });
      button.addEventListener('click', () => this.picture.look(index));
      return button;
    });
    return group(
      'Look',
      colour,
      element('div', { className: 'row' }, wires, openings),
      element('div', { className: 'row' }, ...views),
    );
  }

  // Parts that lie round others would hide them.
  partControls() {
    const looks = ['solid', 'see-through', 'hidden'];
    const labels = this.model.parts.map(({ name, encloses }, index) => {
      const [label, select] = choice(`${name} `, looks, (chosen) =>
        this.picture.setPart(index, looks[chosen]),
      );
      if (encloses) {
        select.value = '1';
        this.picture.setPart(index, looks[1]);
      }
      return label;
    });
    return group('Parts', ...labels);
  }

  shapeControls() {
    const select = element('select');
    select.append(new Option('none', '-1'));
    const subjects = new Map();
    this.model.shapes.forEach((shape, index) => {
      if (!subjects.has(shape.subject)) {
        subjects.set(shape.subject, element('optgroup', { label: shape.subject }));
        select.append(subjects.get(shape.subject));
      }
      const name = shape.phase ? `${shape.subject} / ${shape.phase}` : shape.subject;
      subjects.get(shape.subject).append(new Option(name, String(index)));
    });
    select.addEventListener('change', () => this.chooseShape(Number(select.value)));
    this.shapeSelect = select;
    this.shapeText = element('p', { className: 'quiet' });
    this.shapeText.setAttribute('role', 'status');
    const [overlay] = tick('overlay the shape itself', true, (isOn) => {
      this.overlayWanted = isOn;
      this.update();
    });
    this.overlayWanted = true;
    const children = [
      element('label', {}, 'Put the sliders at ', select),
      element('div', { className: 'row' }, overlay),
      this.shapeText,
    ];
    if (this.model.shape_count > this.model.shapes.length) {
      const text = `The page carries the first ${this.model.shapes.length} of ${this.model.shape_count} shapes.`;
      children.push(element('p', { className: 'quiet', textContent: text }));
    }
    return group('Training shape', ...children);
  }

  buildSliders() {
    this.inputs = this.set.modes.map((mode, index) => {
      const input = element('input', {
        type: 'range',
        min: -LIMIT,
        max: LIMIT,
        step: 0.05,
        value: 0,
        dataset: { mode: String(index) },
      });
      const text = element('span', { className: 'value', ariaHidden: 'true' });
      input.addEventListener('input', () => {
        this.scores[index] = Number(input.value);
        this.update();
      });
      const name = `Mode ${index + 1} (${(100 * mode.share).toFixed(1)} %)`;
      const label = element(
        'label',
        { className: 'mode' },
        element('span', { textContent: name }),
        text,
        input,
      );
      return { input, text, label };
    });
    this.sliders.replaceChildren(...this.inputs.map(({ label }) => label));
  }

  chooseSet(index) {
    this.set = this.model.sets[index];
    this.scores = this.set.modes.map(() => 0);
    this.buildSliders();
    if (this.shape) this.scores = scoresIn(this.model, this.set, this.shape.scores);
    this.update();
  }

  chooseCycle(index) {
    this.cycle = index < 0 ? null : this.model.cycles[index].frames;
    this.cycleSelect.value = String(index + 1);
    if (!this.cycle) this.pause();
    else if (this.shape) this.chooseShape(-1);
    this.update();
  }

  chooseShape(index) {
    if (this.shape) this.scores = this.scores.map(() => 0);
    this.shape = index < 0 ? null : this.model.shapes[index];
    this.shapeSelect.value = String(index);
    if (this.shape) {
      if (this.cycle) this.chooseCycle(-1);
      this.scores = scoresIn(this.model, this.set, this.shape.scores);
    }
    this.update();
  }

  setScores(scores) {
    this.scores = scores;
    this.update();
  }

  play() {
    if (!this.cycle) this.chooseCycle(0);
    this.button.textContent = 'Pause';
    if (this.calm.matches) {
      this.timer = window.setInterval(() => this.advance(1 / CALM_STEPS), 1000);
      return;
    }
    let last = performance.now();
    const step = (now) => {
      if (!this.timer) return;
      this.advance((now - last) / 1000 / SECONDS_PER_CYCLE);
      last = now;
      this.timer = requestAnimationFrame(step);
    };
    this.timer = requestAnimationFrame(step);
  }

  pause() {
    window.clearInterval(this.timer);
    window.cancelAnimationFrame(this.timer);
    this.timer = 0;
    if (this.button) this.button.textContent = 'Play';
  }

  advance(share) {
    this.time = (this.time + share) % 1;
    this.update();
  }

  // Coordinates of the shape that the controls describe.
  coefficients() {
    const found = this.cycle ? cycleAt(this.cycle, this.time) : this.set.mean.slice();
    this.set.modes.forEach((mode, index) => {
      addScaled(found, this.scores[index], mode.coefficients);
    });
    return found;
  }

  update() {
    const { model, picture } = this;
    const coefficients = this.coefficients();
    fillShape(model, coefficients, picture.positions);
    this.inputs.forEach(({ input, text }, index) => {
      const score = this.scores[index];
      if (Number(input.value) !== score) input.value = String(score);
      text.textContent = signed(score);
      input.setAttribute('aria-valuetext', `${score.toFixed(2)} standard deviations`);
    });
    if (this.phase) {
      this.phase.value = String(this.time);
      this.phaseText.textContent = this.cycle ? this.time.toFixed(2) : '';
      this.phase.setAttribute('aria-valuetext', `${this.time.toFixed(2)} of the cycle`);
      this.root.dataset.time = this.time.toFixed(4);
    }
    this.showShape(coefficients);
    this.showColours();
    picture.moved();
  }

  showColours() {
    const { picture, colouring } = this;
    const measured = colouring.measure ? colouring.measure(this) : null;
    picture.setColours(measured);
    this.showLegend(measured);
  }

  // Distances of the points in view from another shape; the scale is that of the set's spread.
  distancesFrom(coefficients, largest) {
    fillShape(this.model, coefficients, this.referencePoints);
    fillDistances(this.picture.positions, this.referencePoints, this.measured);
    return { values: this.measured, largest: Math.max(largest, 1e-9), isOpen: true };
  }

  most(values) {
    return values.reduce((largest, value) => Math.max(largest, value), 0);
  }

  showLegend(measured) {
    const title = measured && (measured.title || this.colouring.title);
    const state = `${this.colouring.label} ${title} ${measured ? measured.largest : ''}`;
    if (this.legend.dataset.state === state) return;
    this.legend.dataset.state = state;
    const heading = element('div', { textContent: title || '' });
    if (!measured || measured.labels) {
      const names = measured
        ? measured.labels.map((name, index) => ({ name, colour: measured.colours[index] }))
        : this.model.parts;
      const swatches = names.map(({ name, colour }) => {
        const swatch = element('span', { className: 'swatch' });
        swatch.style.background = colour;
        return element('span', { className: 'part' }, swatch, name);
      });
      this.legend.replaceChildren(...(measured ? [heading] : []), ...swatches);
      return;
    }
    const { smallest, largest, isOpen } = measured;
    const scale = element('canvas');
    scale.setAttribute('aria-hidden', 'true');
    paintScale(scale);
    const start =
      smallest === undefined ? '0' : `${isOpen ? '\u2264 ' : ''}${endText(smallest)}`;
    const end = `${isOpen ? '\u2265 ' : ''}${smallest === undefined ? largest.toFixed(1) : endText(largest)}`;
    this.legend.replaceChildren(
      heading,
      scale,
      element('div', { className: 'ends' }, element('span', { textContent: start }), end),
    );
  }

  showShape(coefficients) {
    const { picture, shape } = this;
    picture.overlay.visible = Boolean(shape && this.overlayWanted);
    if (!this.shapeText) return;
    if (!shape) {
      this.shapeText.textContent =
        this.colouring.label === 'distance from the training shape'
          ? 'Choose a training shape to colour by the distance from it.'
          : '';
      return;
    }
    if (picture.overlay.visible) {
      fillShape(this.model, shape.scores, picture.overlayPositions);
      picture.overlayMoved();
    }
    const away = distance(this.model, coefficients, shape.scores).toFixed(2);
    this.shapeText.textContent = `The shape in view is ${away} mm (RMS) from it.`;
  }
}

function start() {
  const root = document.getElementById('viewer-root');
  const data = document.getElementById('viewer-data');
  if (!root || !data) return;
  const probe = document.createElement('canvas').getContext('webgl2');
  if (!probe) return; // the page says so and shows pictures
  probe.getExtension('WEBGL_lose_context')?.loseContext();
  try {
    new Viewer(root, readModel(data.textContent));
  } catch (error) {
    root.replaceChildren(); // a driver that promised more than it can do
    root.classList.remove('ready');
    return;
  }
  root.dataset.ready = 'true';
}

start();
